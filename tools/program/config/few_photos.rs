//! Settings that depend on the data set and the start: those for few photos, and exposures.

use super::{AutoSwitch, Settings, SettingsSources};
use ashsplat::train::{Checkpoint, Preset, StrategyType, TrainSettings};
use ashsplat::{Error, Result};
use ashsplat_files::Gallery;

/// Spread of exposures from which presets learn them, stops (tools/strategies.md).
const MIN_SPREAD: f64 = 0.12;

/// Properties of data set and start that determine the defaults of settings.
#[derive(Clone, Copy, Default)]
pub struct DefaultsInput<'a> {
    /// Number of photos to which the settings are adapted, if any.
    photos: Option<usize>,
    /// Settings of the checkpoint from which a training continues.
    continued: Option<&'a TrainSettings>,
    pub(super) sh_degree: u32,
}

impl<'a> DefaultsInput<'a> {
    /// The properties before the data set is read.
    pub fn of_start(start: Option<&'a Checkpoint>) -> Self {
        DefaultsInput { continued: start.map(|start| &start.settings), ..DefaultsInput::default() }
    }

    /// The settings that apply where none are given.
    pub(super) fn defaults(&self, preset: Option<Preset>, strategy: Option<StrategyType>) -> TrainSettings {
        if let (None, None, Some(settings)) = (preset, strategy, self.continued) {
            // The number of iterations may differ from the checkpoint's.
            return TrainSettings { iterations: TrainSettings::default().iterations, ..settings.clone() };
        }
        let usual = match (preset, strategy) {
            (None, Some(strategy)) => TrainSettings::of_strategy(strategy),
            (preset, _) => TrainSettings::of_preset(preset.unwrap_or_default()),
        };
        match self.photos {
            Some(photos) => usual.for_photos(photos),
            None => usual,
        }
    }
}

impl SettingsSources {
    /// Settles the settings for a data set and a start, and reads the points whose depths are trained on. Returns a note on
    /// defaults, unless they come from the checkpoint.
    pub fn settle_for(
        &self,
        gallery: &mut Gallery,
        start: Option<&Checkpoint>,
        sh_degree: u32,
    ) -> Result<(Settings, Option<String>)> {
        let continued = start.map(|start| &start.settings);
        let usual = self.settle(&DefaultsInput { photos: None, continued, sh_degree })?;
        if usual.train.depth_points > 0.0 && gallery.read_tracks()? == 0 {
            let problem = "does not say which photos show which points, whose depths --depth-points needs";
            let remedy = "give a COLMAP model with its observations, or leave --depth-points out";
            return Err(Error::input(&usual.data.source_path, problem, remedy));
        }
        let is_default = !self.has("preset") && !self.has("strategy");
        if start.is_some() && is_default {
            return Ok((usual, None));
        }
        let photos = gallery.train_photos().len();
        let adapted = match usual.data.few_photos {
            AutoSwitch::Auto => Some(photos).filter(|_| usual.train.strategy == StrategyType::Budget),
            AutoSwitch::On => Some(TrainSettings::FEW_PHOTOS),
            AutoSwitch::Off => None,
        };
        let mut settled = self.settle(&DefaultsInput { photos: adapted, continued, sh_degree })?;
        let without = match settled.train.strategy {
            StrategyType::Fixed => Some("fixed"),
            StrategyType::Mcmc => Some("mcmc"),
            StrategyType::Reference | StrategyType::Budget => None,
        };
        if let Some(strategy) = without.filter(|_| usual.data.few_photos == AutoSwitch::On) {
            let problem = format!("on has no settings for --strategy {strategy}; leave one of both out");
            return Err(Error::argument("--few-photos", problem));
        }
        let is_given = |name: &str| self.has(name);
        let adapted = described(photos, is_given, (&usual.train, &settled.train));
        let presets = "settings: --preset default; the article's recipe: --preset reference";
        let lines = [
            is_default.then(|| presets.to_owned()),
            adapted,
            self.settle_exposure(&mut settled, gallery, continued),
        ];
        Ok((settled, lines.into_iter().flatten().reduce(|a, b| format!("{a}\n{b}"))))
    }

    /// With a preset, enables exposures if the photographs differ in exposure, or as in the checkpoint. Returns a note that
    /// says why.
    fn settle_exposure(
        &self,
        settings: &mut Settings,
        gallery: &Gallery,
        continued: Option<&TrainSettings>,
    ) -> Option<String> {
        let is_preset = settings.train.exposure_shared && !self.has("strategy");
        let is_whole = settings.data.job.is_empty() && settings.data.block.is_empty();
        if settings.train.exposure || self.has("exposure") || !is_preset || !is_whole {
            return None;
        }
        if let Some(continued) = continued {
            settings.train.exposure = continued.exposure;
            return None;
        }
        // An unreadable photo is ignored here, because reading all photos reports it.
        let stops = gallery.exposure_spread().ok().flatten().filter(|&stops| stops >= MIN_SPREAD)?;
        settings.train.exposure = true;
        Some(format!(
            "photos differ in exposure from their neighbours by {stops:.2} stops (RMS): --exposure (--exposure=false: as if they did not)"
        ))
    }
}

/// Names what the settings for few photos change; `None` if nothing.
fn described(
    photos: usize,
    is_given: impl Fn(&str) -> bool,
    (before, after): (&TrainSettings, &TrainSettings),
) -> Option<String> {
    let pairs = before.values().into_iter().zip(after.values());
    let changed: Vec<String> = pairs
        .filter(|(before, after)| before != after && !is_given(after.0))
        .map(|(_, (name, value))| format!("--{} {value}", name.replace('_', "-")))
        .collect();
    let changed = Some(changed.join(" ")).filter(|changed| !changed.is_empty())?;
    Some(format!(
        "{photos} photo{} to train on: {changed}, against fitting only these (--few-photos off: as with many)",
        if photos == 1 { "" } else { "s" }
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One photograph more hardly changes the settings.
    #[test]
    fn settings_change_gradually_with_the_number_of_photos() {
        let values = |photos: usize| {
            let train = TrainSettings::default().for_photos(photos);
            [train.dropout, 10.0 * train.opacity_reg, train.decay_last]
        };
        assert_eq!(values(0), values(12));
        assert_eq!(values(32), values(1000));
        assert_eq!(TrainSettings::default().for_photos(32), TrainSettings::default());
        for photos in 0..50 {
            let [more, fewer] = [values(photos + 1), values(photos)];
            assert!(
                more.iter().zip(fewer).all(|(more, fewer)| (0.0..0.02).contains(&(fewer - more))),
                "{photos}"
            );
        }
    }
}
