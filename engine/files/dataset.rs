//! A data set to train on: photographs with their cameras, and initial points.

mod companions;
mod exposures;
mod gallery;
mod inspect;
mod notes;
mod photos;
mod plan;
mod planned_view;
mod reader;
mod unpacked;

use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use rayon::prelude::*;

use crate::host_memory::HostMemory;
use crate::images::{PhotoMemory, PhotoOrientation, Resolution, StoredPhoto};
use crate::init::{RANDOM_POINTS, points_in_view, random_points, seen_box};
use crate::progress::Progress;
use ashsplat::passes::loss::DepthPoint;
use ashsplat::scene::{Camera, PhotoLens, PointCloud, Projection, WorldFrame};
use ashsplat::{Error, Result};
use notes::{may_lack_points, random_points_instead};
use planned_view::PlannedView;

pub use gallery::Gallery;
pub use inspect::DatasetReport;
pub use plan::Level;

/// A data set in memory.
#[derive(Clone, Debug, PartialEq)]
pub struct Dataset {
    /// The frame of cameras and points.
    pub frame: WorldFrame,
    /// Views to train on, by name.
    pub train: Vec<View>,
    /// Held-out views, by name; empty without [`DatasetOptions::eval`].
    pub test: Vec<View>,
    /// Initial points; empty when the model has none.
    pub points: PointCloud,
    /// 1.1 × the largest distance of a training camera to their mean, world units.
    pub scene_extent: f32,
    /// The folder of the COLMAP model, or the transforms.json.
    pub source: PathBuf,
    /// Warnings that do not prevent training.
    pub warnings: Vec<String>,
    /// Treatment of the photos in addition to [`Gallery::notes`], one line each.
    pub notes: Vec<String>,
}

/// One photograph and its camera.
#[derive(Clone, Debug, PartialEq)]
pub struct View {
    /// Path below the images folder.
    pub name: String,
    /// Id in the COLMAP model, or index in the order of names.
    pub image_id: u32,
    /// Id of the camera that took it, in the COLMAP model; 0 for all views of a transforms.json.
    pub camera_id: u32,
    /// The camera at the photo's size in memory.
    pub camera: Camera,
    /// The camera at the photo's size in its file.
    pub original_camera: Camera,
    /// The photo as [`DatasetOptions::undistort`] and [`DatasetOptions::resolution`] say, and its mask.
    pub photo: StoredPhoto,
    /// Inverse depth of each pixel: [`TrainView::inverse_depth`](ashsplat::TrainView::inverse_depth). Present only with
    /// [`DatasetOptions::depths`], for training views.
    pub inverse_depth: Option<Arc<[f32]>>,
    /// Sparse points that the photo shows: [`TrainView::depth_points`](ashsplat::TrainView::depth_points). Present only
    /// after [`Gallery::read_tracks`], for training views.
    pub depth_points: Option<Arc<[DepthPoint]>>,
}

impl View {
    /// The view with a mask on its right half, the columns from ⌊width / 2⌋.
    fn left_half(&self) -> Result<Self> {
        let width = self.photo.width as usize;
        let photo = self.photo.hiding(|pixel| pixel % width >= width / 2)?;
        Ok(Self { photo, ..self.clone() })
    }
}

impl Dataset {
    /// True if a file's content is a ZIP archive, which may hold a data set.
    pub fn is_archive(path: impl AsRef<Path>) -> bool {
        unpacked::starts_like_zip(path.as_ref())
    }

    /// Loads a data set: a folder with a COLMAP model or with `transforms.json` (or `transforms_train.json`),
    /// or a ZIP of one. The photos are decoded in parallel.
    ///
    /// # Errors
    /// [`Error::Input`] for the first problem of cameras or photos, for no registered images and for no training views left by
    /// the split; [`Error::TooLarge`] when the photos do not fit into [`DatasetOptions::host_memory`]; [`Error::Interrupted`].
    pub fn load(path: impl AsRef<Path>, options: &DatasetOptions, progress: Progress<'_>) -> Result<Self> {
        Gallery::open(path, options, progress)?.load(progress)
    }

    fn of(gallery: &Gallery, progress: Progress<'_>) -> Result<Self> {
        let Gallery { options, plan, .. } = gallery;
        let planned = &plan.views;
        plan.check_split()?;
        let mut warnings = plan.warnings.clone();
        let needed = gallery.texel_bytes();
        let beyond = options.beyond_memory(needed);
        let file = beyond.as_ref().map(PhotoMemory::create_file).transpose()?;
        let kept = gallery.map_bytes() + if file.is_some() { 0 } else { needed };
        let (list, total) = (plan.list.display(), planned.len());
        let what = || format!("{list}: keeping its {total} photos in memory (-r makes them smaller)");
        let _kept = options.host_memory.keep(&what, kept)?;
        // Decoding gets the memory that the kept photos leave: waiting for theirs would never end.
        let options =
            &DatasetOptions { host_memory: options.host_memory.beside_photos(kept), ..options.clone() };
        let done = AtomicUsize::new(0);
        progress.step(0, total);
        let [compressed, stored] = [AtomicUsize::new(0), AtomicUsize::new(0)];
        let store = |mut view: View, planned: &PlannedView| -> Result<View> {
            let Some(file) = &file else { return Ok(view) };
            // An archive's folder is gone when the training reads from it. Held-out photos are kept, so that no test fails because
            // one of them is gone.
            let may_read_again =
                !gallery.unpacked.is_temporary() && !planned.held_out && !view.photo.is_masked();
            let (photo, count) = match may_read_again.then(|| planned.compressed(options)).flatten() {
                Some(jpeg) => (file.leave(&view.photo, Arc::new(jpeg))?, &compressed),
                None => (file.store(&view.photo)?, &stored),
            };
            count.fetch_add(1, Ordering::Relaxed);
            view.photo = photo;
            Ok(view)
        };
        let load = |planned: &PlannedView| {
            progress.check()?;
            let (view, photo_use) = planned.load(options)?;
            let trained = |mut view: View| {
                view.inverse_depth = planned.map.as_ref().map(|map| map.load(&view, options)).transpose()?;
                let track = planned.track.as_ref();
                view.depth_points = track.map(|track| gallery::depth_points(&view, track)).transpose()?;
                store(view, planned)
            };
            let has_half = planned.held_out && options.train_test_exp;
            let half = has_half.then(|| trained(view.left_half()?)).transpose()?;
            let view = if planned.held_out { store(view, planned)? } else { trained(view)? };
            progress.step(done.fetch_add(1, Ordering::Relaxed) + 1, total);
            Ok((view, half, photo_use))
        };
        let views = planned.par_iter().map(load).collect::<Result<Vec<_>>>()?;
        let [compressed, stored] = [compressed, stored].map(AtomicUsize::into_inner);
        warnings.extend(beyond.map(|memory| streaming_warning(needed, &memory, compressed, stored)));
        let (mut train, mut test, mut uses) = (Vec::new(), Vec::new(), Vec::new());
        for ((view, half, photo_use), planned) in views.into_iter().zip(planned) {
            uses.push(photo_use);
            if planned.held_out { &mut test } else { &mut train }.push(view);
            train.extend(half);
        }
        let (notes, doubts) = notes::of_pixels(planned.iter().zip(uses), options.alpha);
        warnings.extend(doubts);
        let mut scene_extent = gallery.scene_extent();
        if scene_extent == 0.0 {
            warnings.push("all training cameras are at one place; the scene extent is taken as 1".into());
            scene_extent = 1.0;
        }
        let (source, points) = (plan.source.clone(), plan.points.clone());
        if points.is_empty() {
            const GUESSED: &str = ", at guessed depths: the cameras do not look at one place and so do not tell how far the \
                                   scene is; give points";
            let cameras: Vec<Camera> = train.iter().map(|view| view.camera).collect();
            let guessed = if seen_box(&cameras).is_some() { "" } else { GUESSED };
            warnings.push(random_points_instead() + guessed);
        }
        Ok(Self { frame: plan.frame, train, test, points, scene_extent, source, warnings, notes })
    }

    /// All views by name, including held-out ones.
    pub fn views(&self) -> Vec<&View> {
        let mut views: Vec<&View> = self.test.iter().chain(&self.train).collect();
        // The sort is stable: of two views with one name, the whole one comes first.
        views.sort_by(|a, b| a.name.cmp(&b.name));
        views.dedup_by(|b, a| a.name == b.name);
        views
    }

    /// True if the data set may have no points, as NeRF data sets do.
    pub fn may_lack_points(&self) -> bool {
        may_lack_points(&self.source)
    }

    /// The points, or 100,000 random ones if there are none. Random points fill the box at which all training
    /// cameras look ([`seen_box`]). If the cameras do not look at one place, the points fill each camera's
    /// view ([`points_in_view`]), at depths from a quarter to 16 times the scene extent.
    pub fn initial_points(&self, seed: u64) -> PointCloud {
        if !self.points.is_empty() {
            return self.points.clone();
        }
        let cameras: Vec<Camera> = self.train.iter().map(|view| view.camera).collect();
        match seen_box(&cameras) {
            Some(bounds) => random_points(RANDOM_POINTS, bounds, seed),
            None => points_in_view(RANDOM_POINTS, &cameras, self.scene_extent, seed),
        }
    }

    /// Removes the warning about missing points, because training continues from existing Gaussians.
    pub fn needs_no_points(&mut self) {
        self.warnings.retain(|warning| !warning.starts_with(&random_points_instead()));
    }

    /// Replaces the data set's points.
    pub fn set_points(&mut self, points: PointCloud) {
        self.points = points;
        self.needs_no_points();
    }

    /// Checks everything that training needs, without stopping at the first problem.
    pub fn inspect(
        path: impl AsRef<Path>,
        options: &DatasetOptions,
        progress: Progress<'_>,
    ) -> DatasetReport {
        inspect::inspect(path.as_ref(), options, progress)
    }
}

impl Gallery {
    /// Reads all photos: the whole data set, in parallel.
    pub fn load(&self, progress: Progress<'_>) -> Result<Dataset> {
        Dataset::of(self, progress).map_err(|error| self.unpacked.name(error))
    }
}

/// Warns of photos that exceed their memory budget: those that are decoded again, and those in the file.
fn streaming_warning(needed: u64, memory: &PhotoMemory, compressed: usize, stored: usize) -> String {
    let [mib, allowed] = [needed, memory.bytes].map(|bytes| bytes.div_ceil(1 << 20));
    let in_file = format!("are kept in a file in {} and read when needed", memory.folder.display());
    let places = [(compressed, "unscaled JPEGs are decoded again when needed"), (stored, &in_file)];
    let places = places.iter().filter(|(count, _)| *count > 0);
    let places: Vec<String> = places.map(|(count, place)| format!("{count} {place}")).collect();
    format!("the photos need {mib} MiB and may have {allowed}: {}", places.join(", "))
}

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
