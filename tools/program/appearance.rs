//! Exposures of photographs, and effects of the lenses that took them.

use ashsplat::scene::{Camera, Exposure, LensEffects};
use ashsplat::{Frame, Result};
use ashsplat_files::exposure_json::{self, EXPOSURE_FILE};
use ashsplat_files::lens_json::{LENS_FILE, LensFile};
use std::collections::BTreeMap;
use std::path::Path;

/// Exposure and lens effects of a photograph; none by default.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Appearance {
    pub exposure: Option<Exposure>,
    pub lens: Option<LensEffects>,
}

impl Appearance {
    pub fn is_none(&self) -> bool {
        *self == Appearance::default()
    }

    /// Applies exposure and lens effects to a camera's frame, in the order of training.
    pub fn apply(&self, camera: &Camera, frame: &mut Frame) {
        self.apply_as_taken(camera, camera, frame);
    }

    /// Same as [`Appearance::apply`], but the photo was `taken` with another picture plane; lens effects depend on the
    /// angle.
    pub fn apply_as_taken(&self, taken: &Camera, camera: &Camera, frame: &mut Frame) {
        if let Some(exposure) = &self.exposure {
            exposure.apply(&mut frame.color);
        }
        if let Some(lens) = &self.lens {
            lens.apply_as_taken(taken, camera, &mut frame.color);
        }
    }
}

/// Exposures and lens effects of all photographs of a training, by name.
#[derive(Clone, Debug, Default)]
pub struct Appearances {
    pub exposures: BTreeMap<String, Exposure>,
    /// Lens effects of all photos, held-out ones included.
    pub lenses: LensFile,
}

impl Appearances {
    /// Reads what a training has left in its model folder; empty if nothing was learned.
    ///
    /// # Errors
    /// Names a file with other content.
    pub fn read(folder: &Path) -> Result<Appearances> {
        let [exposures, lenses] = [folder.join(EXPOSURE_FILE), folder.join(LENS_FILE)];
        Ok(Appearances {
            exposures: if exposures.is_file() { exposure_json::read(exposures)? } else { BTreeMap::new() },
            lenses: if lenses.is_file() { LensFile::read(lenses)? } else { LensFile::default() },
        })
    }

    pub fn of(&self, photo: &str) -> Appearance {
        Appearance { exposure: self.exposures.get(photo).copied(), lens: self.lenses.of(photo) }
    }
}
