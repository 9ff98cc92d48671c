//! What is measured: synthetic scenes, trained ones, data sets.

use super::schema::Workload;
use super::synthetic;
use crate::session;
use ashsplat::io::cameras_json;
use ashsplat::io::{Dataset, DatasetOptions, Progress, splats};
use ashsplat::scene::{Camera, Gaussians, Intrinsics, Orbit};
use ashsplat::{Error, RenderSettings, Result, TrainView};
use clap::Args;
use glam::Vec3;
use std::path::{Path, PathBuf};

/// Which Gaussians are rendered, and from where.
#[derive(Args, Clone)]
pub struct SceneArguments {
    /// Gaussians of the synthetic scene
    #[arg(long, value_name = "N", default_value_t = 300_000)]
    pub gaussians: u32,
    /// SH degree of the synthetic scene
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u32).range(0..=3))]
    pub sh_degree: u32,
    /// Width of the picture, pixels [default: the camera's; 1920 for a synthetic scene]
    #[arg(long, value_name = "PIXELS", value_parser = clap::value_parser!(u32).range(1..))]
    pub width: Option<u32>,
    /// Height of the picture, pixels [default: the camera's; 1080 for a synthetic scene]
    #[arg(long, value_name = "PIXELS", value_parser = clap::value_parser!(u32).range(1..))]
    pub height: Option<u32>,
    /// Seed of everything synthetic
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub seed: u64,
    /// A trained scene instead of a synthetic one
    #[arg(long, value_name = "PLY")]
    pub scene: Option<PathBuf>,
    /// Camera: entry N (from 0) of a cameras.json [default: N = 0; without it, one that sees the whole scene]
    #[arg(long, value_name = "FILE[:N]", requires = "scene", conflicts_with = "dataset")]
    pub camera: Option<String>,
    /// A data set: its cameras, its photos for train-step, and its points where there is no --scene
    #[arg(long, value_name = "DATASET")]
    pub dataset: Option<PathBuf>,
    /// View of the data set, by place in the order of names
    #[arg(long, value_name = "N", default_value_t = 0, requires = "dataset")]
    pub view: usize,
}

/// A scene and where it is seen from.
pub struct Scene {
    pub gaussians: Gaussians,
    pub camera: Camera,
    /// The data set's photo of the view.
    pub view: Option<TrainView>,
    pub scene_extent: f32,
    source: String,
}

impl SceneArguments {
    /// Loads or makes the scene. `photos`: whether a data set's photos are wanted.
    pub fn load(&self, photos: bool) -> Result<Scene> {
        let mut scene = match (&self.dataset, &self.scene) {
            (Some(dataset), trained) => self.of_dataset(dataset, trained.as_deref(), photos)?,
            (None, Some(trained)) => {
                let gaussians = splats::read(trained, &splats::ReadOptions { drop_invalid: true })?.gaussians;
                let camera = match &self.camera {
                    Some(place) => named_camera(place)?,
                    None => overview(&gaussians),
                };
                Scene {
                    gaussians,
                    camera,
                    view: None,
                    scene_extent: 1.0,
                    source: trained.display().to_string(),
                }
            }
            (None, None) => {
                let count = self.gaussians as usize;
                Scene {
                    gaussians: synthetic::scene(self.seed, count, self.sh_degree),
                    camera: synthetic::camera(1920, 1080),
                    view: None,
                    scene_extent: 2.5,
                    source: format!("synthetic, seed {}", self.seed),
                }
            }
        };
        if scene.gaussians.is_empty() {
            return Err(Error::argument("scene", "has no Gaussians; give --gaussians 1 or more"));
        }
        let (width, height) =
            (self.width.unwrap_or(scene.camera.width), self.height.unwrap_or(scene.camera.height));
        if self.scene.is_none() && self.dataset.is_none() {
            scene.camera = synthetic::camera(width, height);
        } else if scene.view.is_some() && (width, height) != (scene.camera.width, scene.camera.height) {
            return Err(Error::argument("--width/--height", "cannot change a data set's photos"));
        } else {
            scene.camera = scene.camera.scaled_to(width, height);
        }
        scene.camera.check()?;
        Ok(scene)
    }

    fn of_dataset(&self, dataset: &Path, trained: Option<&Path>, photos: bool) -> Result<Scene> {
        let mut source = dataset.display().to_string();
        let no_view = |views: usize| {
            Error::argument(
                format!("--view {}", self.view),
                format!("the data set has {views} views, from 0"),
            )
        };
        let (camera, view, points, scene_extent) = if photos || trained.is_none() {
            let loaded = Dataset::load(dataset, &DatasetOptions::default(), Progress::default())?;
            let count = loaded.train.len();
            let view = loaded.train.into_iter().nth(self.view).ok_or_else(|| no_view(count))?;
            let camera = view.camera;
            let view = photos.then_some(TrainView { camera, photo: view.photo });
            (camera, view, Some(loaded.points), loaded.scene_extent)
        } else {
            let cameras = session::cameras(dataset)?;
            let camera = cameras.get(self.view).ok_or_else(|| no_view(cameras.len()))?.camera;
            (camera, None, None, 1.0)
        };
        let gaussians = match (trained, points) {
            (Some(trained), _) => {
                source = format!("{} in {source}", trained.display());
                splats::read(trained, &splats::ReadOptions { drop_invalid: true })?.gaussians
            }
            (None, points) => Gaussians::from_points(&points.unwrap_or_default(), self.sh_degree)?,
        };
        Ok(Scene { gaussians, camera, view, scene_extent, source })
    }
}

fn named_camera(place: &str) -> Result<Camera> {
    let (file, index) = match place.rsplit_once(':') {
        Some((file, index)) if !index.is_empty() && index.bytes().all(|b| b.is_ascii_digit()) => {
            (file, index.parse().unwrap_or(usize::MAX))
        }
        _ => (place, 0),
    };
    let cameras = cameras_json::read(file)?;
    let found = cameras.get(index).map(|named| named.camera);
    found.ok_or_else(|| Error::input(file, format!("has {} cameras, not number {index}", cameras.len()), ""))
}

/// A camera that sees the middle nine tenths of a scene.
fn overview(gaussians: &Gaussians) -> Camera {
    let bounds = gaussians.statistics().central_bounds;
    let center = bounds.map_or(Vec3::ZERO, |b| b.center());
    let half_diagonal = bounds.map_or(1.0, |b| 0.5 * b.size().length()).max(1e-3);
    let intrinsics = Intrinsics::from_fov_x(1.0, 960, 540);
    let radius = 0.75 * half_diagonal / (0.5 * 540.0 / intrinsics.fx).atan().sin();
    let orbit = Orbit { center, up: Vec3::NEG_Y, radius, elevation: 0.35, count: 1, intrinsics };
    orbit.cameras().swap_remove(0)
}

impl Scene {
    /// For the result file; counts of a frame are filled in by whoever renders it.
    pub fn workload(&self, settings: &RenderSettings) -> Workload {
        let mut hash = Fnv::default();
        let (g, c) = (&self.gaussians, &self.camera);
        hash.gaussians(g);
        hash.camera(c);
        hash.add(format!("{settings:?}").as_bytes());
        if let Some(view) = &self.view {
            hash.add(&view.photo.rgb);
        }
        Workload {
            source: self.source.clone(),
            hash: hash.hex(),
            gaussians: Some(g.len() as u32),
            sh_degree: Some(g.sh_degree),
            width: Some(c.width),
            height: Some(c.height),
            ..Workload::default()
        }
    }
}

/// FNV-1a, 64 bits.
pub struct Fnv(u64);

impl Default for Fnv {
    fn default() -> Self {
        Self(0xcbf2_9ce4_8422_2325)
    }
}

impl Fnv {
    pub fn add(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            self.0 = (self.0 ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
        }
    }

    pub fn gaussians(&mut self, g: &Gaussians) {
        self.add(bytemuck::cast_slice(&g.means));
        self.add(bytemuck::cast_slice(&g.quats));
        self.add(bytemuck::cast_slice(&g.log_scales));
        self.add(bytemuck::cast_slice(&g.opacity_logits));
        self.add(bytemuck::cast_slice(&g.sh));
    }

    pub fn camera(&mut self, c: &Camera) {
        self.add(bytemuck::cast_slice(&c.camera_from_world.to_cols_array()));
        self.add(bytemuck::cast_slice(&[c.translation.x, c.translation.y, c.translation.z]));
        self.add(bytemuck::cast_slice(&[c.fx, c.fy, c.cx, c.cy]));
        self.add(bytemuck::cast_slice(&[c.width, c.height]));
    }

    pub fn hex(&self) -> String {
        format!("{:016x}", self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::Fnv;

    #[test]
    fn hash_is_fnv_1a() {
        let hash = |text: &str| {
            let mut hash = Fnv::default();
            hash.add(text.as_bytes());
            hash.hex()
        };
        assert_eq!(hash(""), "cbf29ce484222325");
        assert_eq!(hash("foobar"), "85944171f73967e8");
    }
}
