//! `lens.json`, the learned vignetting and response of cameras, and the camera of each photograph.

use std::collections::BTreeMap;
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::{atomic, text};
use ashsplat::scene::LensEffects;
use ashsplat::{Error, Result};

/// Name of the file in a model folder.
pub const LENS_FILE: &str = "lens.json";

/// Largest exponent of a response, and the inverse of the smallest. No real camera exceeds it.
const MAX_GAMMA: f32 = 20.0;

/// Cameras by their ids, and the ids by the names of photographs.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LensFile {
    /// Effects of each camera on colours.
    pub cameras: BTreeMap<u32, LensEffects>,
    /// The camera of each photograph, held-out ones included.
    pub photos: BTreeMap<String, u32>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Document {
    cameras: BTreeMap<u32, Entry>,
    photos: BTreeMap<String, u32>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Entry {
    /// Coefficients of r², r⁴ and r⁶ per channel.
    vignetting: [[f32; 3]; 3],
    /// Exponent per channel.
    response: [f32; 3],
}

impl LensFile {
    /// Effects of the camera that took a photograph; `None` if it is unknown.
    pub fn of(&self, photo: &str) -> Option<LensEffects> {
        self.cameras.get(self.photos.get(photo)?).copied()
    }

    /// Writes the file.
    pub fn write(&self, path: impl AsRef<Path>) -> Result<()> {
        let entry = |effects: &LensEffects| Entry {
            vignetting: effects.rows.map(|[a1, a2, a3, _]| [a1, a2, a3]),
            response: effects.response(),
        };
        let cameras = self.cameras.iter().map(|(&id, effects)| (id, entry(effects))).collect();
        let document = Document { cameras, photos: self.photos.clone() };
        atomic::write(path, |writer| Ok(serde_json::to_writer_pretty(writer, &document)?))
    }

    /// Reads the file of [`LensFile::write`].
    pub fn read(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        let remedy = "expected {\"cameras\": {\"1\": {\"vignetting\": [[0, 0, 0], [0, 0, 0], [0, 0, 0]], \"response\": [1, 1, 1]}}, \
                      \"photos\": {\"photo.jpg\": 1}}";
        let problem = |problem: String| Error::input(path, problem, remedy);
        let document: Document = text::json(path, "a description of cameras' light", remedy)?;
        let mut cameras = BTreeMap::new();
        for (id, Entry { vignetting, response }) in document.cameras {
            if !vignetting.as_flattened().iter().all(|a| a.is_finite()) {
                return Err(problem(format!("camera {id} has a vignetting that is not finite")));
            }
            if !response.iter().all(|gamma| (MAX_GAMMA.recip()..=MAX_GAMMA).contains(gamma)) {
                return Err(problem(format!("camera {id} has the response {response:?}")));
            }
            let row = |c: usize| {
                let [a1, a2, a3] = vignetting[c];
                [a1, a2, a3, response[c].ln()]
            };
            cameras.insert(id, LensEffects { rows: [row(0), row(1), row(2)] });
        }
        if let Some((name, id)) = document.photos.iter().find(|(_, id)| !cameras.contains_key(id)) {
            return Err(problem(format!("{name} is of camera {id}, which it does not describe")));
        }
        Ok(Self { cameras, photos: document.photos })
    }
}
