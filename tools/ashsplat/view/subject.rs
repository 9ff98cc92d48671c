//! What is looked at: Gaussians, how they look, and the cameras and photos that belong to them.

use super::photos::Photos;
use super::protocol::CameraMessage;
use crate::args::HostArguments;
use crate::config::{CAMERAS_FILE, DataSettings};
use crate::model::Model;
use crate::render::{self, LookArguments};
use crate::session;
use ashsplat::scene::{Camera, Gaussians, Intrinsics, Orbit};
use ashsplat::{Error, RenderSettings, Result};
use ashsplat_files::cameras_json::{self, NamedCamera};
use ashsplat_files::{DatasetOptions, Gallery};
use glam::Vec3;
use serde_json::{Value, json};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::SystemTime;

/// SH degree of a data set's points: they have one colour each.
const POINTS_SH_DEGREE: u32 = 0;
/// Where a page begins to look, before it asks for its own size.
const START_SIZE: [u32; 2] = [1280, 720];

/// Something to look at.
pub struct Subject {
    pub name: String,
    pub gaussians: Gaussians,
    /// How it looks as it was trained.
    pub base: RenderSettings,
    /// Of the photos, where there are any.
    pub cameras: Vec<NamedCamera>,
    pub photos: Option<Arc<Photos>>,
    /// What the page says when there is nothing to see, and below the name otherwise.
    pub note: Option<String>,
}

/// What of a scene is wanted, other than by default.
pub struct Wanted<'a> {
    /// Of a model folder.
    pub iteration: Option<u32>,
    /// The data set.
    pub source: Option<&'a Path>,
    /// The folder of its photos.
    pub images: Option<&'a str>,
}

impl Subject {
    /// Before anything is chosen.
    pub fn nothing() -> Subject {
        let note = "No scene is open. Start the viewer with something to look at: `ashsplat view scene.ply`, \
                    `ashsplat view MODEL` (a folder as `ashsplat train -m` leaves it) or `ashsplat view DATASET`.";
        Subject {
            name: "nothing".into(),
            gaussians: Gaussians::default(),
            base: RenderSettings::default(),
            cameras: Vec::new(),
            photos: None,
            note: Some(note.into()),
        }
    }

    /// A file of Gaussians, a model folder, or a data set, of which the points are shown.
    pub fn load(
        path: &Path,
        wanted: &Wanted<'_>,
        look: &LookArguments,
        host: &HostArguments,
        stop: &AtomicBool,
    ) -> Result<Subject> {
        if session::is_dataset(path) {
            return Subject::of_dataset(path, wanted.images, host, stop);
        }
        let model = Model::locate(path, wanted.iteration)?;
        let scene = look.load(&model.ply, host)?;
        let mut data = model.settings.data.clone();
        if let Some(source) = wanted.source {
            data.source_path = source.to_owned();
        }
        if let Some(images) = wanted.images {
            data.images = images.to_owned();
        }
        let asked = wanted.source.is_some() || wanted.images.is_some();
        let white = model.settings.train.white_background;
        let gallery = match (asked, photos_of(&data, white, host, stop)) {
            (true, gallery) => Some(gallery?),
            (false, Err(Error::Interrupted)) => return Err(Error::Interrupted),
            // What the training had may have gone.
            (false, gallery) => gallery.ok(),
        };
        let own = model.folder.as_ref().map(|(folder, _)| folder.join(CAMERAS_FILE));
        let cameras = match (&gallery, own.filter(|own| own.is_file())) {
            (Some(gallery), _) => gallery.cameras(),
            (None, Some(own)) => cameras_json::read(own)?,
            (None, None) => Vec::new(),
        };
        Ok(Subject {
            name: path.display().to_string(),
            base: look.settings(&model.settings, &scene.header)?,
            gaussians: scene.gaussians,
            cameras,
            photos: gallery.map(|gallery| Arc::new(Photos::new(gallery))),
            note: model.folder.map(|(_, iteration)| format!("iteration {iteration}")),
        })
    }

    fn of_dataset(
        path: &Path,
        images: Option<&str>,
        host: &HostArguments,
        stop: &AtomicBool,
    ) -> Result<Subject> {
        let data = DataSettings { source_path: path.to_owned(), ..Default::default() };
        let mut options = DatasetOptions { host_memory: host.memory(), ..Default::default() };
        if let Some(images) = images {
            options.images = images.to_owned();
        }
        let gallery = session::open(&data, &options, stop)?;
        let points = gallery.points();
        let (gaussians, note) = if points.is_empty() {
            (Gaussians::default(), "This data set has no points to show; its photos are on the right.")
        } else {
            (
                ashsplat_files::initial_gaussians(points, POINTS_SH_DEGREE)?,
                "the data set's points: nothing is trained yet",
            )
        };
        Ok(Subject {
            name: path.display().to_string(),
            gaussians,
            base: RenderSettings::default(),
            cameras: gallery.cameras(),
            photos: Some(Arc::new(Photos::new(gallery))),
            note: Some(note.into()),
        })
    }

    /// What a page is told first.
    pub fn greeting(&self, device: &str, training: Option<u32>) -> Value {
        let [width, height] = START_SIZE;
        let intrinsics = Intrinsics::from_fov_x(1.0, width, height);
        let cameras: Vec<Camera> = self.cameras.iter().map(|named| named.camera).collect();
        let middle = self.gaussians.statistics().central_bounds.map(|bounds| bounds.center());
        let orbit = Orbit::around_scene(&cameras, middle, 1, intrinsics);
        let orbit =
            orbit.unwrap_or_else(|| render::orbit_around(&self.gaussians, Vec3::NEG_Y, 1, intrinsics));
        let start = cameras.first().copied().or_else(|| orbit.cameras().first().copied());
        let photo =
            |named: &NamedCamera| json!({ "name": named.name, "camera": CameraMessage::of(&named.camera) });
        json!({
            "type": "scene",
            "name": self.name,
            "run": run_name(),
            "note": self.note,
            "empty": self.gaussians.is_empty(),
            "gaussians": self.gaussians.len(),
            "sh_degree": self.gaussians.sh_degree,
            "background": self.base.background,
            "device": device,
            "version": env!("CARGO_PKG_VERSION"),
            "cameras": self.cameras.iter().map(photo).collect::<Vec<_>>(),
            "has_photos": self.photos.is_some(),
            "start": start.map(|camera| CameraMessage::of(&camera)),
            "pivot": orbit.center.to_array(),
            "up": orbit.up.to_array(),
            "radius": orbit.radius,
            "training": training,
        })
    }
}

/// A word of this run's own, so that no browser takes another run's photos for its.
fn run_name() -> String {
    let now = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
    format!("{:x}", now.as_nanos())
}

/// The photos of a training's data set, at the size at which it uses them.
fn photos_of(
    data: &DataSettings,
    white_background: bool,
    host: &HostArguments,
    stop: &AtomicBool,
) -> Result<Gallery> {
    if data.source_path.as_os_str().is_empty() {
        return Err(Error::argument("data set", "is not known; name it with -s DATASET"));
    }
    session::open(data, &session::options(data, white_background, host)?, stop)
}
