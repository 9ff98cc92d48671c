//! A data set to train on: photographs with their cameras, and points to start from.

mod inspect;

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};

use rayon::prelude::*;

use super::cameras_json;
use super::colmap::{ColmapImage, Model};
use super::images::{Photo, Resolution, photo_size};
use super::progress::Progress;
use crate::scene::init::{RANDOM_POINTS, random_points};
use crate::scene::{Bounds, Camera, Gaussians, PointCloud, scene_extent};
use crate::{Error, Result};

pub use inspect::DatasetReport;

/// How to load a data set.
#[derive(Clone, Debug, PartialEq)]
pub struct DatasetOptions {
    /// Size at which the photos are used.
    pub resolution: Resolution,
    /// Name of the subfolder with the photos. In one called `…_2`, `…_4` or `…_8`, as benchmark data sets have
    /// them, the photos may be of that fraction of their cameras' size.
    pub images: String,
    /// Whether every `test_every`-th view by name is held out.
    pub eval: bool,
    /// Distance of the held-out views; 8 in the reference implementation and the literature.
    pub test_every: u32,
    /// Whether what is transparent in a photo becomes white rather than black.
    pub white_background: bool,
}

impl Default for DatasetOptions {
    fn default() -> Self {
        Self {
            resolution: Resolution::Auto,
            images: "images".into(),
            eval: false,
            test_every: 8,
            white_background: false,
        }
    }
}

impl DatasetOptions {
    /// The colour behind transparent photos, (r, g, b) in [0, 1].
    pub fn background(&self) -> [f32; 3] {
        [if self.white_background { 1.0 } else { 0.0 }; 3]
    }

    /// By how much the photos in the folder are smaller than the model's cameras.
    fn divisor(&self) -> u32 {
        match self.images.trim_end_matches('/').rsplit_once('_') {
            Some((_, "2")) => 2,
            Some((_, "4")) => 4,
            Some((_, "8")) => 8,
            _ => 1,
        }
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
    /// Id in the COLMAP model.
    pub image_id: u32,
    /// The camera at the photo's size in memory.
    pub camera: Camera,
    /// The camera at the photo's size in its file.
    pub original_camera: Camera,
    /// The photo, scaled by [`DatasetOptions::resolution`].
    pub photo: Photo,
}

/// A data set in memory.
#[derive(Clone, Debug, PartialEq)]
pub struct Dataset {
    /// Views to train on, by name.
    pub train: Vec<View>,
    /// Held-out views, by name; empty without [`DatasetOptions::eval`].
    pub test: Vec<View>,
    /// Points to start from; empty when the model has none.
    pub points: PointCloud,
    /// 1.1 × the largest distance of a training camera to their mean, world units.
    pub scene_extent: f32,
    /// The folder of the COLMAP model.
    pub source: PathBuf,
    /// What the user should know though it does not prevent training.
    pub warnings: Vec<String>,
}

impl Dataset {
    /// Loads a data set with a COLMAP model; the photos are decoded in parallel.
    ///
    /// # Errors
    /// [`Error::Io`] and [`Error::Input`] for the first problem of model or photos: see
    /// [`super::colmap::find`], [`Model::read`], [`Model::camera_of`] and [`Photo::read_sized`]; no registered
    /// images; no training views left by the split. [`Error::Interrupted`] when `progress` says so.
    pub fn load(path: impl AsRef<Path>, options: &DatasetOptions, progress: Progress<'_>) -> Result<Self> {
        let path = path.as_ref();
        let model = Model::of_dataset(path)?;
        let planned = plan_views(path, &model, options).into_iter().collect::<Result<Vec<_>>>()?;
        check_split(&model, options, planned.len())?;
        let done = AtomicUsize::new(0);
        let total = planned.len();
        progress.step(0, total);
        let views = planned
            .into_par_iter()
            .map(|planned| {
                progress.check()?;
                let view = planned.load(options)?;
                progress.step(done.fetch_add(1, Ordering::Relaxed) + 1, total);
                Ok(view)
            })
            .collect::<Result<Vec<_>>>()?;
        Ok(Self::assemble(model, views, options))
    }

    fn assemble(model: Model, views: Vec<View>, options: &DatasetOptions) -> Self {
        let (mut train, mut test) = (Vec::new(), Vec::new());
        for (index, view) in views.into_iter().enumerate() {
            if options.is_test(index) { test.push(view) } else { train.push(view) }
        }
        let mut warnings = model.warnings;
        let mut extent = scene_extent(train.iter().map(|view: &View| view.camera.position()));
        if extent == 0.0 {
            warnings.push("all training cameras are at one place; the scene extent is taken as 1".into());
            extent = 1.0;
        }
        if model.points.is_empty() {
            warnings.push(format!("no points to start from; {RANDOM_POINTS} random ones stand in for them"));
        }
        Self {
            train,
            test,
            points: model.points,
            scene_extent: extent,
            source: model.source.folder,
            warnings,
        }
    }

    /// All views by name, held-out ones among the others.
    pub fn views(&self) -> Vec<&View> {
        let mut views: Vec<&View> = self.train.iter().chain(&self.test).collect();
        views.sort_by(|a, b| a.name.cmp(&b.name));
        views
    }

    /// The points, or, when there are none, 100,000 random ones around the training cameras: in the cube whose
    /// middle is that of the cameras' box and whose half edge is the scene extent.
    pub fn initial_points(&self, seed: u64) -> PointCloud {
        if !self.points.is_empty() {
            return self.points.clone();
        }
        let positions = self.train.iter().map(|view| view.camera.position());
        let center = Bounds::of(positions).map_or(glam::Vec3::ZERO, |bounds| bounds.center());
        let bounds = Bounds { min: center - self.scene_extent, max: center + self.scene_extent };
        random_points(RANDOM_POINTS, bounds, seed)
    }

    /// The Gaussians that training starts from.
    ///
    /// # Errors
    /// As [`Gaussians::from_points`].
    pub fn initial_gaussians(&self, sh_degree: u32, seed: u64) -> Result<Gaussians> {
        Gaussians::from_points(&self.initial_points(seed), sh_degree)
    }

    /// Writes `cameras.json`: held-out views first, then the training views, at their original sizes, as the
    /// reference implementation does.
    ///
    /// # Errors
    /// As [`cameras_json::write()`].
    pub fn write_cameras_json(&self, path: impl AsRef<Path>) -> Result<()> {
        let views = self.test.iter().chain(&self.train);
        cameras_json::write(path, views.map(|view| (view.name.as_str(), &view.original_camera)))
    }

    /// Checks everything that training would need, without stopping at the first problem.
    pub fn inspect(
        path: impl AsRef<Path>,
        options: &DatasetOptions,
        progress: Progress<'_>,
    ) -> DatasetReport {
        inspect::inspect(path.as_ref(), options, progress)
    }
}

/// A view whose photo is not loaded yet.
struct PlannedView<'a> {
    image: &'a ColmapImage,
    camera: Camera,
    photo_path: PathBuf,
}

impl PlannedView<'_> {
    /// The photo, and its camera at the size of the file.
    fn read_photo(&self, options: &DatasetOptions) -> Result<(Photo, Camera)> {
        let camera = self.camera_of_file(options.divisor())?;
        let photo = Photo::read_sized(&self.photo_path, options.background(), camera.width, camera.height)?;
        Ok((photo, camera))
    }

    /// The camera at the size of a photo that somebody divided by `divisor`, rounding each side as they liked.
    fn camera_of_file(&self, divisor: u32) -> Result<Camera> {
        let camera = self.camera;
        if divisor == 1 {
            return Ok(camera);
        }
        let (width, height) = photo_size(&self.photo_path)?;
        if (width, height) == (camera.width, camera.height) {
            return Ok(camera);
        }
        let fits = |photo: u32, camera: u32| photo == camera / divisor || photo == camera.div_ceil(divisor);
        if !fits(width, camera.width) || !fits(height, camera.height) {
            let Camera { width: w, height: h, .. } = camera;
            let problem =
                format!("is {width}x{height} pixels, 1/{divisor} of its camera's {w}x{h} was expected");
            return Err(Error::input(
                &self.photo_path,
                problem,
                "use photos of that size, or another folder",
            ));
        }
        Ok(camera.scaled_to(width, height))
    }

    fn load(&self, options: &DatasetOptions) -> Result<View> {
        let (photo, original_camera) = self.read_photo(options)?;
        let (width, height) = options.resolution.apply(photo.width, photo.height);
        Ok(View {
            name: self.image.name.clone(),
            image_id: self.image.id,
            camera: original_camera.scaled_to(width, height),
            original_camera,
            photo: photo.scaled_to(width, height)?,
        })
    }
}

/// What each registered image needs, by name; the photos are looked for but not opened.
fn plan_views<'a>(path: &Path, model: &'a Model, options: &DatasetOptions) -> Vec<Result<PlannedView<'a>>> {
    let mut images: Vec<&ColmapImage> = model.images.iter().collect();
    images.sort_by(|a, b| a.name.cmp(&b.name));
    let folder = path.join(&options.images);
    if !folder.is_dir() {
        let remedy = "put the photos there, or name their folder with --images";
        return vec![Err(Error::input(folder, "there is no folder with photos", remedy))];
    }
    let plan = |image| {
        let camera = model.camera_of(image)?;
        let photo_path = image.photo_path(&folder, &model.file("images"))?;
        if !photo_path.is_file() {
            let problem = format!("the photo of image {} is missing", image.id);
            return Err(Error::input(
                photo_path,
                problem,
                "copy it there, or remove the image from the model",
            ));
        }
        Ok(PlannedView { image, camera, photo_path })
    };
    images.into_iter().map(plan).collect()
}

fn check_split(model: &Model, options: &DatasetOptions, views: usize) -> Result<()> {
    let file = model.file("images");
    if views == 0 {
        let remedy = "run COLMAP's mapper again with more overlapping photos";
        return Err(Error::input(file, "no images are registered", remedy));
    }
    if (0..views).all(|index| options.is_test(index)) {
        let problem = format!("all of its {views} images are held out, none is left to train on");
        return Err(Error::input(file, problem, "train without --eval"));
    }
    Ok(())
}
