//! Exposure and lens effects of the photos: a view can be drawn as its photo was exposed, through the lens that took it.

use ashsplat::scene::Camera;
use ashsplat::{Error, Result, Trainer};
use ashsplat_files::cameras_json::NamedCamera;
use ashsplat_program::appearance::{Appearance, Appearances};
use std::collections::BTreeMap;

/// Exposure and lens effects of a scene's photos, by camera index. Empty by default.
#[derive(Default)]
pub struct PhotoAppearances {
    photos: Vec<(Camera, Source)>,
}

/// Where a photo's exposure and lens effects come from.
#[derive(Clone, Copy)]
enum Source {
    /// Saved by a finished training.
    Kept(Appearance),
    /// Learned by the running training.
    Training(Places),
}

/// Indices of the training views that have a photo's exposure and its lens.
#[derive(Clone, Copy, Default, PartialEq, Eq)]
struct Places {
    exposure: Option<usize>,
    lens: Option<usize>,
}

impl PhotoAppearances {
    pub fn kept(cameras: &[NamedCamera], appearances: &Appearances) -> PhotoAppearances {
        let photo = |named: &NamedCamera| (named.camera, Source::Kept(appearances.of(&named.name)));
        PhotoAppearances { photos: cameras.iter().map(photo).collect() }
    }

    /// Takes a running training: `trained` are the names of its views, `takers` the cameras of all photos.
    pub fn in_training(
        cameras: &[NamedCamera],
        trained: &[String],
        takers: &BTreeMap<String, u32>,
        [exposure, lens_effects]: [bool; 2],
    ) -> PhotoAppearances {
        let photo = |named: &NamedCamera| {
            let exposure = trained.iter().position(|name| exposure && *name == named.name);
            let same = |name: &String| lens_effects && takers.get(name) == takers.get(&named.name);
            let places = Places { exposure, lens: trained.iter().position(same) };
            (named.camera, Source::Training(places))
        };
        PhotoAppearances { photos: cameras.iter().map(photo).collect() }
    }

    /// True if the photo has an exposure or lens effects.
    pub fn has(&self, photo: usize) -> bool {
        self.photos.get(photo).is_some_and(|(_, source)| match source {
            Source::Kept(appearance) => !appearance.is_none(),
            Source::Training(places) => *places != Places::default(),
        })
    }

    /// Returns a photo's exposure and lens effects, and the camera at which it was taken. `trainer`: the running training, if any.
    ///
    /// # Errors
    /// [`Error::Argument`] for a photo that does not exist; when the device is lost.
    pub fn of(&self, photo: usize, trainer: Option<&Trainer>) -> Result<(Camera, Appearance)> {
        let (camera, source) = self.photos.get(photo).ok_or_else(|| {
            let problem = format!("there is none of number {photo}: the scene has {}", self.photos.len());
            Error::argument("photo", problem)
        })?;
        let appearance = match (source, trainer) {
            (Source::Kept(appearance), _) => *appearance,
            (Source::Training(places), Some(trainer)) => places.appearance(trainer)?,
            (Source::Training(_), None) => Appearance::default(),
        };
        Ok((*camera, appearance))
    }
}

impl Places {
    /// Reads the current exposure and lens effects of a running training.
    fn appearance(self, trainer: &Trainer) -> Result<Appearance> {
        let Self { exposure, lens } = self;
        let exposures = exposure.map(|_| trainer.exposures()).transpose()?;
        let lenses = lens.map(|_| trainer.lens_effects()).transpose()?;
        Ok(Appearance {
            exposure: exposures.and_then(|all| all.get(exposure?).copied()),
            lens: lenses.and_then(|all| all.get(lens?).copied()),
        })
    }
}
