//! A data set to train on: photographs with their cameras, and initial points.

mod companions;
mod depths;
mod doubtful_lens;
mod exif_orientation;
mod gallery;
mod inspect;
mod lens_note;
mod mask;
mod own_frame;
mod photo_folder;
mod photo_sizes;
mod photo_use;
mod plan;
mod planned_view;
mod scaling;
mod tracks;
mod unpacked;
mod used_part;

use std::collections::HashSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use rayon::prelude::*;

use super::cameras_json::{self, NamedCamera};
use super::host_memory::HostMemory;
use super::images::{PhotoFile, PhotoMemory, PhotoOrientation, Resolution, StoredPhoto};
use super::progress::Progress;
use crate::init::{RANDOM_POINTS, points_in_view, random_points, seen_box};
use crate::photo_points::{PHOTO_POINTS, photo_points};
use ashsplat::Result;
use ashsplat::loss::DepthPoint;
use ashsplat::scene::{Camera, Gaussians, PointCloud, WorldFrame};

pub use gallery::Gallery;
pub use inspect::DatasetReport;
use photo_use::PhotoUse;
use unpacked::Unpacked;

/// How to load a data set.
#[derive(Clone, Debug, PartialEq)]
pub struct DatasetOptions {
    /// Size at which the photos are used.
    pub resolution: Resolution,
    /// Name of the subfolder with the photos. In one called `…_2`, `…_4` or `…_8`, as benchmark data sets
    /// use, the photos may have that fraction of their cameras' size.
    pub images: String,
    /// Folder of inverse-depth maps, absolute or within the data set: a 16-bit PNG per photo, with the photo's name.
    /// Their scale and offset are in the model's `depth_params.json`; without that file, they are fitted to the sparse
    /// points.
    pub depths: Option<PathBuf>,
    /// Rotation of photos by their metadata.
    pub orientation: PhotoOrientation,
    /// Frame of cameras and points, such as the frame of an existing scene. `None` chooses one that suits the data set.
    pub frame: Option<WorldFrame>,
    /// True to hold out every `test_every`-th view by name.
    pub eval: bool,
    /// True to train on the left half of held-out views too (columns below ⌊width / 2⌋). Their views are then in
    /// both lists, in [`Dataset::train`] with a mask on the right half.
    pub train_test_exp: bool,
    /// Interval of the held-out views; 8 in the reference implementation and the literature.
    pub test_every: u32,
    /// True if transparent pixels of a photo become white, false for black.
    pub white_background: bool,
    /// True if transparent photos keep their opacity, so that training can compose them over random backgrounds:
    /// [`StoredPhoto::with_opacity`].
    pub keep_opacity: bool,
    /// Memory budget of the photos; photos beyond it stay in a file. `None` holds all photos in memory.
    pub photo_memory: Option<PhotoMemory>,
    /// Memory budget of photos, while they are decoded and while they are kept. With [`DatasetOptions::photo_memory`],
    /// photos beyond it are kept in a file. Without, a data set that does not fit is refused before its photos are
    /// read.
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
    fn divisor(&self) -> u32 {
        match self.images.trim_end_matches('/').rsplit_once('_') {
            Some((_, "2")) => 2,
            Some((_, "4")) => 4,
            Some((_, "8")) => 8,
            _ => 1,
        }
    }

    /// Number of copies of a view's photo that are kept.
    fn copies(&self, held_out: bool) -> u64 {
        1 + u64::from(held_out && self.train_test_exp)
    }

    fn is_test(&self, index: usize) -> bool {
        self.eval && index.is_multiple_of(self.test_every.max(1) as usize)
    }
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
    /// The photo, undistorted and scaled by [`DatasetOptions::resolution`], and its mask.
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

impl Dataset {
    /// True if a file's content is a ZIP archive, which may hold a data set.
    pub fn is_archive(path: impl AsRef<Path>) -> bool {
        unpacked::starts_like_zip(path.as_ref())
    }

    /// Loads a data set: a folder with a COLMAP model or with `transforms.json` (or `transforms_train.json`),
    /// or a ZIP of one. The photos are decoded and, if the lens distorts, undistorted in parallel.
    ///
    /// # Errors
    /// [`ashsplat::Error::Io`] and [`ashsplat::Error::Input`] for the first problem of cameras or photos: see
    /// [`super::colmap::find`], [`super::colmap::Model::read`], [`super::colmap::Model::camera_of`],
    /// [`super::transforms::Transforms::read`] and [`super::PhotoFileFormat::read_sized`]; no registered images; no
    /// training views left by the split. [`ashsplat::Error::TooLarge`] when the photos do not fit into
    /// [`DatasetOptions::host_memory`]. [`ashsplat::Error::Interrupted`] when `progress` requests the stop.
    pub fn load(path: impl AsRef<Path>, options: &DatasetOptions, progress: Progress<'_>) -> Result<Self> {
        Gallery::open(path, options, progress)?.load(progress)
    }

    /// The cameras of all views by name, at the photos' original sizes. The photos are not decoded.
    ///
    /// # Errors
    /// Same as [`Gallery::open`].
    pub fn cameras(path: impl AsRef<Path>, options: &DatasetOptions) -> Result<Vec<NamedCamera>> {
        Ok(Gallery::open(path, options, Progress::NONE)?.cameras())
    }

    fn of(gallery: &Gallery, progress: Progress<'_>) -> Result<Self> {
        let Gallery { options, views: planned, held_out, .. } = gallery;
        plan::check_split(&gallery.list, held_out)?;
        let mut warnings = gallery.warnings.clone();
        let needed = gallery.texel_bytes();
        let file = photo_file(needed, options, &mut warnings)?;
        let kept = gallery.map_bytes() + if file.is_some() { 0 } else { needed };
        let what = || {
            format!(
                "{}: keeping its {} photos in memory (-r makes them smaller)",
                gallery.list.display(),
                planned.len()
            )
        };
        let _kept = options.host_memory.keep(&what, kept)?;
        // Decoding gets the memory that the kept photos leave: waiting for theirs would never end.
        let options =
            &DatasetOptions { host_memory: options.host_memory.beside_photos(kept), ..options.clone() };
        let done = AtomicUsize::new(0);
        let total = planned.len();
        progress.step(0, total);
        let stored = |mut view: View| -> Result<View> {
            if let Some(file) = &file {
                view.photo = file.store(&view.photo)?;
            }
            Ok(view)
        };
        let views = planned
            .par_iter()
            .zip(held_out)
            .zip(&gallery.maps)
            .enumerate()
            .map(|(index, ((planned, &held_out), map))| {
                progress.check()?;
                let read = planned.read_photo(options)?;
                let photo_use = PhotoUse::of(&read);
                let mut view = planned.view_of(read)?;
                let map_of = |view: &View| map.as_ref().map(|map| map.load(view, options)).transpose();
                let track = gallery.tracks.get(index).and_then(Option::as_ref);
                let points_of =
                    |view: &View| track.map(|track| tracks::depth_points(view, track)).transpose();
                let mut half = None;
                if options.copies(held_out) > 1 {
                    let mut view = view.left_half()?;
                    view.inverse_depth = map_of(&view)?;
                    view.depth_points = points_of(&view)?;
                    half = Some(stored(view)?);
                }
                if !held_out {
                    view.inverse_depth = map_of(&view)?;
                    view.depth_points = points_of(&view)?;
                }
                let view = stored(view)?;
                progress.step(done.fetch_add(1, Ordering::Relaxed) + 1, total);
                Ok((view, half, photo_use))
            })
            .collect::<Result<Vec<_>>>()?;
        Ok(Self::assemble(gallery, views, warnings))
    }

    /// `views`: each with its training half, if it is held out.
    fn assemble(
        gallery: &Gallery,
        views: Vec<(View, Option<View>, PhotoUse)>,
        mut warnings: Vec<String>,
    ) -> Self {
        let (mut train, mut test, mut uses) = (Vec::new(), Vec::new(), Vec::new());
        for ((view, half, photo_use), held_out) in views.into_iter().zip(&gallery.held_out) {
            uses.push(photo_use);
            if *held_out {
                test.push(view)
            } else {
                train.push(view)
            }
            train.extend(half);
        }
        let (notes, doubts) = photo_use::lines(gallery.views.iter().zip(uses));
        warnings.extend(doubts);
        let mut extent = gallery.scene_extent();
        if extent == 0.0 {
            warnings.push("all training cameras are at one place; the scene extent is taken as 1".into());
            extent = 1.0;
        }
        let points = gallery.points.clone();
        if points.is_empty() {
            let cameras: Vec<Camera> = train.iter().map(|view| view.camera).collect();
            let guessed = match seen_box(&cameras) {
                Some(_) => "",
                None => {
                    ", at guessed depths: the cameras do not look at one place and so do not tell how far the scene is; \
                     give points"
                }
            };
            warnings.push(random_points_instead() + guessed);
        }
        let source = gallery.source.clone();
        Self { frame: gallery.frame, train, test, points, scene_extent: extent, source, warnings, notes }
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

    /// Up to 20,000 points at which the training photographs agree: [`photo_points`]. The inner error is their number
    /// if it is below 1000: random points are the better start then.
    ///
    /// `memory` is the budget with which the data set was loaded: [`DatasetOptions::host_memory`].
    ///
    /// # Errors
    /// Same as [`photo_points`].
    pub fn points_in_photos(
        &self,
        seed: u64,
        memory: &HostMemory,
        progress: Progress<'_>,
    ) -> Result<Result<PointCloud, usize>> {
        let kept = |view: &View| {
            let photo = view.photo.file().map_or(view.photo.bytes(), |_| 0);
            photo + view.inverse_depth.as_ref().map_or(0, |map| size_of_val(&**map) as u64)
        };
        let memory = memory.beside_photos(self.train.iter().chain(&self.test).map(kept).sum());
        let found = photo_points(&self.train, self.scene_extent, PHOTO_POINTS, seed, &memory, progress)?;
        Ok(if found.len() < MIN_PHOTO_POINTS { Err(found.len()) } else { Ok(found) })
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

    /// The initial Gaussians of training.
    ///
    /// # Errors
    /// Same as [`initial_gaussians`](crate::initial_gaussians).
    pub fn initial_gaussians(&self, sh_degree: u32, seed: u64) -> Result<Gaussians> {
        crate::initial_gaussians(&self.initial_points(seed), sh_degree)
    }

    /// Writes `cameras.json`: held-out views first, then the training views, at their original sizes, as the
    /// reference implementation does.
    ///
    /// # Errors
    /// Same as [`cameras_json::write()`].
    pub fn write_cameras_json(&self, path: impl AsRef<Path>) -> Result<()> {
        let held_out: HashSet<&str> = self.test.iter().map(|view| view.name.as_str()).collect();
        let others = self.train.iter().filter(|view| !held_out.contains(view.name.as_str()));
        let views = self.test.iter().chain(others);
        let named = views.map(|view| (view.name.as_str(), &view.original_camera));
        cameras_json::write(path, named, &self.frame)
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

/// Creates the file for photos that exceed their memory budget.
fn photo_file(
    needed: u64,
    options: &DatasetOptions,
    warnings: &mut Vec<String>,
) -> Result<Option<Arc<PhotoFile>>> {
    let Some(memory) = beyond_memory(needed, options) else { return Ok(None) };
    let (mib, allowed) = (needed.div_ceil(1 << 20), memory.bytes >> 20);
    warnings.push(format!(
        "the photos need {mib} MiB and may have {allowed}: they are kept in a file in {} and read when needed",
        memory.folder.display()
    ));
    memory.create_file().map(Some)
}

/// The photos' memory budget if `needed` bytes exceed it.
fn beyond_memory(needed: u64, options: &DatasetOptions) -> Option<PhotoMemory> {
    let memory = options.photo_memory.as_ref()?;
    // Decoding uses the other half.
    let bytes = memory.bytes.min(options.host_memory.limit() / 2);
    (needed > bytes).then(|| PhotoMemory { bytes, ..memory.clone() })
}

/// True if the source may have no points: a JSON file with cameras.
fn may_lack_points(source: &Path) -> bool {
    source.extension().is_some_and(|ending| ending == "json")
}

/// Least number of points in the photographs; with fewer, random points are the better start.
const MIN_PHOTO_POINTS: usize = 1000;

/// The warning about random initial points.
fn random_points_instead() -> String {
    format!("no points to start from; {RANDOM_POINTS} random ones stand in for them")
}
