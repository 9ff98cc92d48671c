//! The settings for few photos.

use super::{Overrides, Settings, When};
use ashsplat::trainer::TrainSettings;
use ashsplat::{Error, Result};
use ashsplat_files::Gallery;
use std::path::Path;

impl Settings {
    /// What follows from the data set: the settings for few photos, with a line to say about them, and the points whose depths
    /// are trained on.
    pub fn settle(
        self,
        gallery: &mut Gallery,
        (file, overrides): (Option<&Path>, &Overrides),
    ) -> Result<(Settings, Option<String>)> {
        let photos = gallery.train_photos()?.len();
        let few = match self.data.few_photos {
            When::Auto => photos < TrainSettings::FEW_PHOTOS,
            When::On => true,
            When::Off => false,
        };
        if self.train.depth_points > 0.0 && gallery.read_tracks()? == 0 {
            let problem = "does not say which photos show which points, whose depths --depth-points needs";
            let remedy = "give a COLMAP model with its observations, or leave --depth-points out";
            return Err(Error::input(&self.data.source_path, problem, remedy));
        }
        if !few {
            return Ok((self, None));
        }
        let settled = Settings::resolve_from(TrainSettings::of_few_photos, file, overrides)?;
        let line = described(photos, &self.train, &settled.train);
        Ok((settled, line))
    }
}

/// What the settings for few photos change; None for nothing.
fn described(photos: usize, before: &TrainSettings, after: &TrainSettings) -> Option<String> {
    let pairs = before.values().into_iter().zip(after.values());
    let changed: Vec<String> = pairs
        .filter(|(before, after)| before != after)
        .map(|(_, (name, value))| format!("--{} {value}", name.replace('_', "-")))
        .collect();
    let changed = Some(changed.join(" ")).filter(|changed| !changed.is_empty())?;
    Some(format!(
        "only {photos} photos to train on: {changed}, so that growth ends before it fits nothing but these \
         (--few-photos off: as with many)"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use ashsplat::trainer::StrategyType;

    #[test]
    fn what_is_given_wins_over_the_settings_for_few_photos() {
        let mut overrides = Overrides::default();
        overrides.train.0.insert("densify_until_iter".into(), 9000.into());
        let settled =
            Settings::resolve_from(TrainSettings::of_few_photos, None, &overrides).expect("settings");
        let preset = TrainSettings::of_few_photos(StrategyType::Reference);
        assert_eq!(settled.train, TrainSettings { densify_until_iter: 9000, ..preset.clone() });
        assert_eq!(described(8, &settled.train, &settled.train), None);
        let said = described(8, &TrainSettings::default(), &preset).expect("a line");
        assert!(said.starts_with("only 8 photos to train on: --"), "{said}");
        assert!(said.contains("--few-photos off") && said.contains("--densify-until-iter 1500"), "{said}");
    }

    /// Settings that a run has left have its decision in them.
    #[test]
    fn a_dump_settles_to_itself() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("settings.toml");
        let few = TrainSettings::of_few_photos(StrategyType::Reference);
        for train in [few, TrainSettings::default()] {
            let settings = Settings { train, ..Settings::default() };
            std::fs::write(&path, settings.to_toml().expect("a dump")).expect("written");
            let none = Overrides::default();
            let read = Settings::resolve_from(TrainSettings::of_few_photos, Some(&path), &none);
            assert_eq!(read.expect("settings"), settings);
        }
    }
}
