//! The settings for few photos.

use super::{Given, Settings, When};
use ashsplat::train::{Checkpoint, OptimizerType, Preset, StrategyType, TrainSettings};
use ashsplat::{Error, Result};
use ashsplat_files::Gallery;

/// Facts of data set and start, on which settings depend that are not given.
#[derive(Clone, Copy, Default)]
pub struct Facts {
    /// For few photos: the default strategy, and the scene's extent.
    few_photos: Option<(StrategyType, f32)>,
    /// SH degree that the start has already.
    pub(super) sh_degree: u32,
}

impl Facts {
    pub(super) fn defaults(&self, preset: Option<Preset>, strategy: Option<StrategyType>) -> TrainSettings {
        match (self.few_photos, preset) {
            (None, None) => TrainSettings::of_strategy(strategy.unwrap_or_default()),
            (None, Some(preset)) => TrainSettings::of_preset(preset),
            (Some((usual, extent)), None) => TrainSettings::of_few_photos(strategy.unwrap_or(usual), extent),
            (Some((_, extent)), Some(preset)) => TrainSettings::of_preset_for_few_photos(preset, extent),
        }
    }
}

impl Given {
    /// Settles the settings for a data set and a start of this SH degree, and reads the points whose depths are trained
    /// on. Returns a note on what few photos change. A training that continues from a checkpoint keeps its strategy.
    pub fn settle_for(
        &self,
        gallery: &mut Gallery,
        start: Option<&Checkpoint>,
        sh_degree: u32,
    ) -> Result<(Settings, Option<String>)> {
        let usual = self.settle(&Facts { few_photos: None, sh_degree })?;
        let photos = gallery.train_photos().len();
        let few = match usual.data.few_photos {
            When::Auto => photos < TrainSettings::FEW_PHOTOS,
            When::On => true,
            When::Off => false,
        };
        if usual.train.depth_points > 0.0 && gallery.read_tracks()? == 0 {
            let problem = "does not say which photos show which points, whose depths --depth-points needs";
            let remedy = "give a COLMAP model with its observations, or leave --depth-points out";
            return Err(Error::input(&usual.data.source_path, problem, remedy));
        }
        let strategy = match start {
            _ if !few => return Ok((usual, None)),
            // A continued training keeps its settings, even those of an earlier version.
            Some(start) if made_with(start, &usual.train) => return Ok((usual, None)),
            Some(start) => strategy_of(start).unwrap_or_default(),
            // Budgeted growth of few photos is not measured with this optimiser.
            None if usual.train.optimizer_type == OptimizerType::SparseAdam => StrategyType::Reference,
            None => StrategyType::Budget,
        };
        let extent = usual.data.extent(gallery.scene_extent(), gallery.frame());
        let settled = self.settle(&Facts { few_photos: Some((strategy, extent)), sh_degree })?;
        let without = match settled.train.strategy {
            StrategyType::Fixed => Some("fixed"),
            StrategyType::Mcmc => Some("mcmc"),
            StrategyType::Reference | StrategyType::Budget => None,
        };
        if let Some(strategy) = without.filter(|_| usual.data.few_photos == When::On) {
            let problem = format!("on has no settings for --strategy {strategy}; leave one of both out");
            return Err(Error::argument("--few-photos", problem));
        }
        let line = described(photos, |name| self.has(name), (&usual.train, &settled.train));
        Ok((settled, line))
    }
}

/// True if a checkpoint is from a run with these settings, except for the number of iterations.
fn made_with(start: &Checkpoint, settings: &TrainSettings) -> bool {
    TrainSettings { iterations: settings.iterations, ..start.settings.clone() } == *settings
}

/// The strategy of a checkpoint, unless it is a host's own.
fn strategy_of(start: &Checkpoint) -> Option<StrategyType> {
    toml::Value::String(start.strategy.name.clone()).try_into().ok()
}

/// Names the settings that the settings for few photos change; `None` if there are none.
fn described(
    photos: usize,
    is_given: impl Fn(&str) -> bool,
    (before, after): (&TrainSettings, &TrainSettings),
) -> Option<String> {
    // The name of a strategy implies its settings, and the start its SH degree.
    let usual = match before.strategy == after.strategy {
        true => before.clone(),
        false => TrainSettings {
            strategy: before.strategy,
            sh_degree_start: after.sh_degree_start,
            ..TrainSettings::of_strategy(after.strategy)
        },
    };
    let pairs = usual.values().into_iter().zip(after.values());
    let mut changed: Vec<String> = pairs
        .filter(|(usual, after)| usual != after && !is_given(after.0))
        .map(|(_, (name, value))| format!("--{} {value}", name.replace('_', "-")))
        .collect();
    changed.sort_by_key(|option| !option.starts_with("--strategy "));
    let changed = Some(changed.join(" ")).filter(|changed| !changed.is_empty())?;
    Some(format!(
        "only {photos} photos to train on: {changed}, against fitting only these (--few-photos off: as with many)"
    ))
}

#[cfg(test)]
mod tests {
    use super::super::Overrides;
    use super::*;
    use std::path::Path;
    use toml::Table;

    const EXTENT: f32 = 4.0;

    fn resolved(file: Option<&Path>, overrides: &Overrides) -> Result<Settings> {
        let few_photos = Some((StrategyType::Budget, EXTENT));
        Given::read(file, overrides)?.settle(&Facts { few_photos, sh_degree: 0 })
    }

    /// A scene in other units is trained the same.
    #[test]
    fn the_weight_on_scales_goes_by_the_extent() {
        let weight = |extent: f32| TrainSettings::of_few_photos(StrategyType::Budget, extent).scale_reg;
        let weights = [0.045, 4.5, 45.0, 4.3277, 1e-3].map(weight);
        assert_eq!(weights, [1.0, 0.01, 0.001, 0.0104, 45.0]);
        // The trainer refuses an invalid extent, so the weight must stay valid here.
        for extent in [0.0, -1.0, f32::NAN, f32::INFINITY] {
            let settings = TrainSettings::of_few_photos(StrategyType::Budget, extent);
            assert!(settings.scale_reg == 0.0 && settings.check().is_ok(), "{extent}");
        }
    }

    #[test]
    fn what_is_given_wins_over_the_settings_for_few_photos() {
        let settled = |given: &[(&str, toml::Value)]| {
            let mut overrides = Overrides::default();
            overrides.train.0.extend(given.iter().map(|(key, value)| ((*key).to_owned(), value.clone())));
            resolved(None, &overrides).expect("settings").train
        };
        let usual = TrainSettings::of_few_photos(StrategyType::Budget, EXTENT);
        assert_eq!(settled(&[]), usual);
        assert_eq!(settled(&[("scale_reg", 0.5.into())]), TrainSettings { scale_reg: 0.5, ..usual.clone() });
        assert_eq!(settled(&[("dropout", 0.0.into())]), TrainSettings { dropout: 0.0, ..usual.clone() });
        let reference = TrainSettings::of_few_photos(StrategyType::Reference, EXTENT);
        assert_eq!(settled(&[("strategy", "reference".into())]), reference);
        let preset = Overrides { preset: Some("quality".into()), ..Overrides::default() };
        let preset = resolved(None, &preset);
        let quality = TrainSettings::of_preset(Preset::Quality);
        assert!(usual.average_last > quality.average_last);
        let TrainSettings { dropout, opacity_reg, scale_reg, scaling_lr, .. } = usual;
        let TrainSettings { average_last, position_lr_final, scale_sh_degree, .. } = usual;
        let keeps = TrainSettings { scaling_lr, average_last, position_lr_final, ..quality };
        let keeps = TrainSettings { scale_sh_degree, ..keeps };
        let expected = TrainSettings { dropout, opacity_reg, scale_reg, ..keeps };
        assert_eq!(preset.expect("settings").train, expected);

        let none = |_: &str| false;
        assert_eq!(described(8, none, (&usual, &usual)), None);
        let before = TrainSettings { iterations: 900, ..TrainSettings::default() };
        let given: Table = "iterations = 900\nlate_min_opacity = 0.1".parse().expect("a table");
        let after = TrainSettings { iterations: 900, ..usual };
        let said = described(8, |name| given.contains_key(name), (&before, &after)).expect("a line");
        assert!(said.starts_with("only 8 photos to train on: --strategy budget --"), "{said}");
        let parts = [
            "--few-photos off",
            "--dropout 0.2",
            "--cap-ratio 8",
            "--opacity-reg 0.01",
            "--scale-reg 0.0112",
            "--average-last 0.25",
            "--scale-sh-degree false",
        ];
        for part in parts {
            assert!(said.contains(part), "{said}");
        }
        // Neither the given settings, nor those that the strategy implies.
        for part in ["iterations", "late-min-opacity", "absgrad", "position", "--sh-degree"] {
            assert!(!said.contains(part), "{said}");
        }
        let said = described(8, none, (&TrainSettings::default(), &reference)).expect("a line");
        assert!(said.contains("to train on: --densify-until-iter 1500,"), "{said}");
    }

    /// A dump of settings includes this decision.
    #[test]
    fn a_dump_settles_to_itself() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("settings.toml");
        let few = |strategy| TrainSettings::of_few_photos(strategy, EXTENT);
        for train in [few(StrategyType::Reference), few(StrategyType::Budget), TrainSettings::default()] {
            let settings = Settings { train, ..Settings::default() };
            std::fs::write(&path, settings.to_toml().expect("a dump")).expect("written");
            let none = Overrides::default();
            let read = resolved(Some(&path), &none);
            assert_eq!(read.expect("settings"), settings);
        }
    }
}
