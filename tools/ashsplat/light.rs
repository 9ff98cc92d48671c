//! What photographs have of light besides the scene: their exposures, and the effects of the lenses that took them.

use ashsplat::scene::{Camera, Exposure, LensEffects};
use ashsplat::{Frame, Result};
use ashsplat_files::exposure_json::{self, EXPOSURE_FILE};
use ashsplat_files::lens_json::{LENS_FILE, LensFile};
use std::collections::BTreeMap;
use std::path::Path;

/// What a photograph made of the scene's colours: nothing by default.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Light {
    pub exposure: Option<Exposure>,
    pub lens: Option<LensEffects>,
}

impl Light {
    pub fn is_none(&self) -> bool {
        *self == Light::default()
    }

    /// Changes the colours of a camera's frame, in the order of training.
    pub fn apply(&self, camera: &Camera, frame: &mut Frame) {
        self.apply_as_taken(camera, camera, frame);
    }

    /// As [`Light::apply`], where the photo was `taken` with another picture plane: its lens is at the same angles.
    pub fn apply_as_taken(&self, taken: &Camera, camera: &Camera, frame: &mut Frame) {
        if let Some(exposure) = &self.exposure {
            exposure.apply(&mut frame.color);
        }
        if let Some(lens) = &self.lens {
            lens.apply_as_taken(taken, camera, &mut frame.color);
        }
    }
}

/// That of all photographs of a training, by their names.
#[derive(Clone, Debug, Default)]
pub struct Lights {
    /// Of the photos that were trained on.
    pub exposures: BTreeMap<String, Exposure>,
    /// Also of photos that were held out.
    pub lenses: LensFile,
}

impl Lights {
    /// What a training has left in its model folder: nothing where it did not learn it.
    ///
    /// # Errors
    /// For a file that is not one of these, naming it.
    pub fn read(folder: &Path) -> Result<Lights> {
        let [exposures, lenses] = [folder.join(EXPOSURE_FILE), folder.join(LENS_FILE)];
        Ok(Lights {
            exposures: if exposures.is_file() { exposure_json::read(exposures)? } else { BTreeMap::new() },
            lenses: if lenses.is_file() { LensFile::read(lenses)? } else { LensFile::default() },
        })
    }

    /// That of a photograph.
    pub fn of(&self, photo: &str) -> Light {
        Light { exposure: self.exposures.get(photo).copied(), lens: self.lenses.of(photo) }
    }
}
