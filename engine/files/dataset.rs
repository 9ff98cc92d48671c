//! A data set to train on: photographs with their cameras, and initial points.

mod companions;
mod crop;
mod depths;
mod exposures;
mod gallery;
mod inspect;
mod level;
mod mask;
mod notes;
mod options;
mod photos;
mod plan;
mod planned_view;
mod read;
mod unpacked;

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use rayon::prelude::*;

use crate::images::{PhotoFile, StoredPhoto};
use crate::init::{RANDOM_POINTS, points_in_view, random_points, seen_box};
use crate::progress::Progress;
use ashsplat::Result;
use ashsplat::passes::loss::DepthPoint;
use ashsplat::scene::{Camera, PointCloud, WorldFrame};
use notes::{may_lack_points, random_points_instead};
use planned_view::{PhotoUse, PlannedView};

pub use gallery::Gallery;
pub use inspect::DatasetReport;
pub use level::Level;
pub use options::{AlphaUse, DatasetOptions, EvalSplit};

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
    /// [`Error::Input`](ashsplat::Error::Input) for the first problem of cameras or photos, for no registered images and
    /// for no training views left by the split; [`Error::TooLarge`](ashsplat::Error::TooLarge) when the photos do not fit into
    /// [`DatasetOptions::host_memory`]; [`Error::Interrupted`](ashsplat::Error::Interrupted).
    pub fn load(path: impl AsRef<Path>, options: &DatasetOptions, progress: Progress<'_>) -> Result<Self> {
        Gallery::open(path, options, progress)?.load(progress)
    }

    fn of(gallery: &Gallery, progress: Progress<'_>) -> Result<Self> {
        let Gallery { options, views: planned, .. } = gallery;
        plan::check_split(&gallery.plan.list, planned)?;
        let mut warnings = gallery.plan.warnings.clone();
        let needed = gallery.texel_bytes();
        let file = photo_file(needed, options, &mut warnings)?;
        let kept = gallery.map_bytes() + if file.is_some() { 0 } else { needed };
        let (list, total) = (gallery.plan.list.display(), planned.len());
        let what = || format!("{list}: keeping its {total} photos in memory (-r makes them smaller)");
        let _kept = options.host_memory.keep(&what, kept)?;
        // Decoding gets the memory that the kept photos leave: waiting for theirs would never end.
        let options =
            &DatasetOptions { host_memory: options.host_memory.beside_photos(kept), ..options.clone() };
        let done = AtomicUsize::new(0);
        progress.step(0, total);
        let stored = |mut view: View| -> Result<View> {
            if let Some(file) = &file {
                view.photo = file.store(&view.photo)?;
            }
            Ok(view)
        };
        let load = |planned: &PlannedView| {
            progress.check()?;
            let (view, photo_use) = planned.load(options)?;
            let trained = |mut view: View| {
                view.inverse_depth = planned.map.as_ref().map(|map| map.load(&view, options)).transpose()?;
                let track = planned.track.as_ref();
                view.depth_points = track.map(|track| gallery::depth_points(&view, track)).transpose()?;
                stored(view)
            };
            let has_half = planned.held_out && options.train_test_exp;
            let half = has_half.then(|| trained(view.left_half()?)).transpose()?;
            let view = if planned.held_out { stored(view)? } else { trained(view)? };
            progress.step(done.fetch_add(1, Ordering::Relaxed) + 1, total);
            Ok((view, half, photo_use))
        };
        let views = planned.par_iter().map(load).collect::<Result<Vec<_>>>()?;
        Ok(Self::assemble(gallery, views, warnings))
    }

    /// `views`: each with its training half, if it is held out.
    fn assemble(
        gallery: &Gallery,
        views: Vec<(View, Option<View>, PhotoUse)>,
        mut warnings: Vec<String>,
    ) -> Self {
        let (mut train, mut test, mut uses) = (Vec::new(), Vec::new(), Vec::new());
        for ((view, half, photo_use), planned) in views.into_iter().zip(&gallery.views) {
            uses.push(photo_use);
            if planned.held_out { &mut test } else { &mut train }.push(view);
            train.extend(half);
        }
        let (notes, doubts) = notes::of_pixels(gallery.views.iter().zip(uses), gallery.options.alpha);
        warnings.extend(doubts);
        let mut extent = gallery.scene_extent();
        if extent == 0.0 {
            warnings.push("all training cameras are at one place; the scene extent is taken as 1".into());
            extent = 1.0;
        }
        let points = gallery.plan.points.clone();
        if points.is_empty() {
            const GUESSED: &str = ", at guessed depths: the cameras do not look at one place and so do not tell how far the \
                                   scene is; give points";
            let cameras: Vec<Camera> = train.iter().map(|view| view.camera).collect();
            let guessed = if seen_box(&cameras).is_some() { "" } else { GUESSED };
            warnings.push(random_points_instead() + guessed);
        }
        let source = gallery.plan.source.clone();
        Self { frame: gallery.plan.frame, train, test, points, scene_extent: extent, source, warnings, notes }
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

/// Creates the file for photos that exceed their memory budget.
fn photo_file(
    needed: u64,
    options: &DatasetOptions,
    warnings: &mut Vec<String>,
) -> Result<Option<Arc<PhotoFile>>> {
    let Some(memory) = options.beyond_memory(needed) else { return Ok(None) };
    let (mib, allowed) = (needed.div_ceil(1 << 20), memory.bytes >> 20);
    warnings.push(format!(
        "the photos need {mib} MiB and may have {allowed}: they are kept in a file in {} and read when needed",
        memory.folder.display()
    ));
    memory.create_file().map(Some)
}
