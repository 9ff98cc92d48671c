//! How a data set is loaded.

use std::path::PathBuf;

use crate::host_memory::HostMemory;
use crate::images::{PhotoMemory, PhotoOrientation, Resolution};
use ashsplat::scene::WorldFrame;

/// How to load a data set.
#[derive(Clone, Debug, PartialEq)]
pub struct DatasetOptions {
    /// Size at which the photos are used.
    pub resolution: Resolution,
    /// Name of the subfolder with the photos. In one called `…_2`, `…_4` or `…_8`, as benchmark data sets
    /// use, the photos may have that fraction of their cameras' size.
    pub images: String,
    /// Folder of inverse-depth maps, absolute or within the data set: a 16-bit PNG per photo, with the photo's name.
    /// Scale and offset are in the model's `depth_params.json`, or else are fitted to the sparse points.
    pub depths: Option<PathBuf>,
    /// Rotation of photos by their metadata.
    pub orientation: PhotoOrientation,
    /// Frame of cameras and points, such as the frame of an existing scene. `None` chooses one that suits the data set.
    pub frame: Option<WorldFrame>,
    /// True to hold out every `test_every`-th view by name.
    pub eval: bool,
    /// True to train on the left half of held-out views too (columns below ⌊width / 2⌋). Their views are then in
    /// both lists, in [`Dataset::train`](super::Dataset::train) with a mask on the right half.
    pub train_test_exp: bool,
    /// Interval of the held-out views; 8 in the reference implementation and the literature.
    pub test_every: u32,
    /// True if transparent pixels of a photo become white, false for black.
    pub white_background: bool,
    /// True if transparent photos keep their opacity, so that training can compose them over random backgrounds:
    /// [`StoredPhoto::with_opacity`](crate::StoredPhoto::with_opacity).
    pub keep_opacity: bool,
    /// Memory budget of the photos; photos beyond it stay in a file. `None` holds all photos in memory.
    pub photo_memory: Option<PhotoMemory>,
    /// Memory budget of photos, while they are decoded and while they are kept. With [`DatasetOptions::photo_memory`],
    /// photos beyond it are kept in a file; without, the data set is refused before its photos are read.
    pub host_memory: HostMemory,
}

impl Default for DatasetOptions {
    fn default() -> Self {
        Self {
            resolution: Resolution::Auto,
            images: "images".into(),
            depths: None,
            orientation: PhotoOrientation::Auto,
            frame: None,
            eval: false,
            train_test_exp: false,
            test_every: 8,
            white_background: false,
            keep_opacity: false,
            photo_memory: None,
            host_memory: HostMemory::default(),
        }
    }
}

impl DatasetOptions {
    /// The colour under transparent pixels, (r, g, b) in [0, 1].
    pub fn background(&self) -> [f32; 3] {
        [if self.white_background { 1.0 } else { 0.0 }; 3]
    }

    /// Ratio of the model's camera size to the size of the photos in the folder.
    pub(super) fn divisor(&self) -> u32 {
        let ending = self.images.trim_end_matches('/').rsplit_once('_');
        ending.and_then(|(_, ending)| [2, 4, 8].into_iter().find(|by| ending == by.to_string())).unwrap_or(1)
    }

    /// Number of copies of a view's photo that are kept.
    pub(super) fn copies(&self, held_out: bool) -> u64 {
        1 + u64::from(held_out && self.train_test_exp)
    }

    pub(super) fn is_test(&self, index: usize) -> bool {
        self.eval && index.is_multiple_of(self.test_every.max(1) as usize)
    }

    /// The photos' memory budget if `needed` bytes exceed it.
    pub(super) fn beyond_memory(&self, needed: u64) -> Option<PhotoMemory> {
        let memory = self.photo_memory.as_ref()?;
        // Decoding uses the other half.
        let bytes = memory.bytes.min(self.host_memory.limit() / 2);
        (needed > bytes).then(|| PhotoMemory { bytes, ..memory.clone() })
    }
}
