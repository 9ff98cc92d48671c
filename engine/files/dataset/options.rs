//! How a data set is loaded.

use std::path::PathBuf;
use std::str::FromStr;

use super::level::Level;
use crate::host_memory::HostMemory;
use crate::images::{PhotoMemory, PhotoOrientation, Resolution};
use ashsplat::scene::{PhotoLens, Projection, WorldFrame};
use ashsplat::{Error, Result};

/// Which views are held out by [`DatasetOptions::eval`], where a data set does not say so.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum EvalSplit {
    /// Every [`DatasetOptions::test_every`]-th by name, beginning with the first, as in the reference implementation.
    #[default]
    Reference,
    /// The reference's from 24 views on. Fewer often lie along an arc: as many are held out, at equal distances from each other and
    /// the ends.
    Inner,
}

/// Use of the photos' alpha channels.
///
/// The default is Brush's. Its README says of "images with transparency" that "this will force the final splat to match the
/// transparency of the input", and of masks in files that "this ignores parts of the image that are masked out". Beside such
/// a mask Brush drops the alpha channel, which is used here.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum AlphaUse {
    /// Transparent pixels show the background.
    #[default]
    Target,
    /// Pixels that are more transparent than opaque do not count.
    Mask,
    /// Colours count as stored.
    Ignore,
}

impl FromStr for AlphaUse {
    type Err = Error;

    /// `target`, `mask` or `ignore`.
    fn from_str(text: &str) -> Result<Self> {
        match text {
            "target" => Ok(Self::Target),
            "mask" => Ok(Self::Mask),
            "ignore" => Ok(Self::Ignore),
            _ => Err(Error::argument("alpha", format!("'{text}' is not target, mask or ignore"))),
        }
    }
}

/// Number of views from which [`EvalSplit::Inner`] is the reference's.
const MANY_VIEWS: usize = 24;

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
    /// True to replace photos of lenses by the largest photos of pinholes without blank pixels, as COLMAP's image_undistorter
    /// does. Otherwise they are used as they were taken.
    pub undistort: bool,
    /// Rotation of photos by their metadata.
    pub orientation: PhotoOrientation,
    /// Rotation that turns cameras and points upright.
    pub level: Level,
    /// Frame of cameras and points, such as the frame of an existing scene. `None` chooses one that suits the data set.
    pub frame: Option<WorldFrame>,
    /// True to hold out every `test_every`-th view.
    pub eval: bool,
    /// Selects the held-out views.
    pub eval_split: EvalSplit,
    /// True to train on the left half of held-out views too (columns below ⌊width / 2⌋). Their views are then in
    /// both lists, in [`Dataset::train`](super::Dataset::train) with a mask on the right half.
    pub train_test_exp: bool,
    /// Interval of the held-out views; 8 in the reference implementation and the literature.
    pub test_every: u32,
    /// Use of the photos' alpha channels.
    pub alpha: AlphaUse,
    /// True if transparent pixels of a photo become white, false for black.
    pub white_background: bool,
    /// True if transparent photos keep their opacity with [`AlphaUse::Target`], so that training can compose them over random backgrounds:
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
            undistort: false,
            orientation: PhotoOrientation::Auto,
            level: Level::Off,
            frame: None,
            eval: false,
            eval_split: EvalSplit::Reference,
            train_test_exp: false,
            test_every: 8,
            alpha: AlphaUse::Target,
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

    /// The lens of the pictures that are made of the photos of a lens: the same, or the pinhole that replaces it. None if none can.
    pub(super) fn used_lens(&self, lens: &PhotoLens) -> Option<PhotoLens> {
        match self.undistort && lens.projection != Projection::Perspective {
            true => lens.inscribed_pinhole().map(PhotoLens::pinhole),
            false => Some(*lens),
        }
    }

    /// Ratio of the model's camera size to the size of the photos in the folder.
    pub(super) fn divisor(&self) -> u32 {
        let ending = self.images.trim_end_matches(std::path::is_separator).rsplit_once('_');
        ending.and_then(|(_, ending)| [2, 4, 8].into_iter().find(|by| ending == by.to_string())).unwrap_or(1)
    }

    /// True for each held-out view of `views`, by name.
    pub(super) fn held_out(&self, views: usize) -> Vec<bool> {
        let every = self.test_every.max(1) as usize;
        let held = views.div_ceil(every);
        let is_inner = self.eval_split == EvalSplit::Inner && (2..MANY_VIEWS).contains(&views);
        let place = |test: usize| if is_inner { (2 * test + 1) * views / (2 * held) } else { test * every };
        let mut held_out = vec![false; views];
        (0..held).filter(|_| self.eval).for_each(|test| held_out[place(test)] = true);
        held_out
    }

    /// The photos' memory budget if `needed` bytes exceed it.
    pub(super) fn beyond_memory(&self, needed: u64) -> Option<PhotoMemory> {
        let memory = self.photo_memory.as_ref()?;
        // Decoding uses the other half.
        let bytes = memory.bytes.min(self.host_memory.limit() / 2);
        (needed > bytes).then(|| PhotoMemory { bytes, ..memory.clone() })
    }
}
