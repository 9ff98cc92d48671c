//! Workloads: synthetic scenes, trained ones, data sets.

use super::schema::Workload;
use super::synthetic;
use ashsplat::scene::gaussians::sh_coefficients;
use ashsplat::scene::{Camera, Gaussians, Intrinsics, WorldFrame};
use ashsplat::train::MomentsType;
use ashsplat::{Error, RenderSettings, Result, ShStorage, TrainView};
use ashsplat_files::{Dataset, DatasetOptions, Gallery, Progress, cameras_json, splats};
use ashsplat_program::args::HostArguments;
use ashsplat_program::look::{orbit_around, parse_sh_storage};
use clap::Args;
use glam::Vec3;
use std::path::{Path, PathBuf};

/// Most Gaussians of a synthetic scene.
pub const MAX_GAUSSIANS: i64 = 1 << 26;

/// A synthetic scene and its picture.
#[derive(Args, Clone)]
pub struct SyntheticArguments {
    /// Gaussians of the synthetic scene [default: 300000]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(..=MAX_GAUSSIANS))]
    pub gaussians: Option<u32>,
    /// SH degree of the synthetic scene, and of what starts from a data set's points [default: 3]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=3))]
    pub sh_degree: Option<u32>,
    /// Width of the picture, pixels [default: the camera's; 1920 for a synthetic scene]
    #[arg(long, value_name = "PIXELS", value_parser = clap::value_parser!(u32).range(1..))]
    pub width: Option<u32>,
    /// Height of the picture, pixels [default: the camera's; 1080 for a synthetic scene]
    #[arg(long, value_name = "PIXELS", value_parser = clap::value_parser!(u32).range(1..))]
    pub height: Option<u32>,
    /// Seed of everything synthetic [default: 0]
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
}

impl SyntheticArguments {
    pub const GAUSSIANS: u32 = 300_000;
    pub const SH_DEGREE: u32 = 3;

    pub fn sh_degree(&self) -> u32 {
        self.sh_degree.unwrap_or(Self::SH_DEGREE)
    }

    pub fn seed(&self) -> u64 {
        self.seed.unwrap_or(0)
    }

    /// Refuses a scene that this machine's memory cannot hold.
    pub fn check(&self) -> Result<()> {
        let count = self.gaussians.unwrap_or(Self::GAUSSIANS);
        let coefficients = sh_coefficients(self.sh_degree());
        // Mean, rotation, scales, opacity, coefficients.
        let floats = 3 + 4 + 3 + 1 + 3 * coefficients;
        // Twice, because a processor as the device needs another copy. The memory is requested and released here, since a
        // failing allocation later would end the program.
        if Vec::<f32>::new().try_reserve_exact((2 * floats).saturating_mul(count as usize)).is_ok() {
            return Ok(());
        }
        let gigabytes = 8e-9 * floats as f64 * f64::from(count);
        let problem = format!("take {gigabytes:.1} GB, more than this machine's memory; give fewer");
        Err(Error::argument(format!("{count} Gaussians"), problem))
    }

    pub fn load(&self) -> Result<Scene> {
        self.check()?;
        let (count, seed) = (self.gaussians.unwrap_or(Self::GAUSSIANS), self.seed());
        let (width, height) = (self.width.unwrap_or(1920), self.height.unwrap_or(1080));
        let scene = Scene {
            gaussians: synthetic::scene(seed, count as usize, self.sh_degree()),
            camera: synthetic::camera(width, height),
            view: None,
            scene_extent: 2.5,
            storage: Storage::default(),
            source: format!("synthetic, seed {seed}"),
        };
        scene.checked()
    }
}

/// Which Gaussians are rendered, and from where.
#[derive(Args, Clone)]
pub struct SceneArguments {
    #[command(flatten)]
    pub synthetic: SyntheticArguments,
    /// A trained scene instead of a synthetic one
    #[arg(long, value_name = "FILE")]
    scene: Option<PathBuf>,
    /// Camera: entry N (from 0) of a cameras.json [default: N = 0; without it, one that sees the whole scene]
    #[arg(long, value_name = "FILE[:N]", requires = "scene", conflicts_with = "dataset")]
    camera: Option<String>,
    /// A data set: its cameras, its photos for train-step, and its points where there is no --scene
    #[arg(long, value_name = "DATASET")]
    dataset: Option<PathBuf>,
    /// View of the data set, by place in the order of names
    #[arg(long, value_name = "N", default_value_t = 0, requires = "dataset")]
    view: usize,
    #[command(flatten)]
    storage: Storage,
}

/// Storage of Gaussians on the device.
#[derive(Args, Clone, Copy, Default)]
pub struct Storage {
    /// Storage of SH: f32, half or bytes; train-step has no bytes, and its halves take packed moments
    #[arg(long, value_name = "STORAGE", default_value = "f32", value_parser = parse_sh_storage)]
    pub sh_storage: ShStorage,
    /// Train-step with packed moments of Adam
    #[arg(long)]
    pub packed_moments: bool,
}

impl Storage {
    /// Returns the words for a report, which stand behind the scene's name.
    fn note(self) -> String {
        let moments = if self.packed_moments { ", packed moments" } else { "" };
        match self.sh_storage {
            ShStorage::F32 => moments.into(),
            stored => format!(", SH as {stored:?}{moments}").to_lowercase(),
        }
    }

    pub fn moments(self) -> MomentsType {
        match self.packed_moments {
            true => MomentsType::Packed,
            false => MomentsType::F32,
        }
    }
}

pub struct Scene {
    pub gaussians: Gaussians,
    pub camera: Camera,
    pub view: Option<TrainView>,
    pub scene_extent: f32,
    pub storage: Storage,
    source: String,
}

impl SceneArguments {
    /// A file's scene, with the picture's size if it differs from the camera's.
    pub fn of_file(file: &Path, camera: Option<&str>, (width, height): (Option<u32>, Option<u32>)) -> Self {
        Self {
            synthetic: SyntheticArguments { gaussians: None, sh_degree: None, width, height, seed: None },
            scene: Some(file.to_owned()),
            camera: camera.map(str::to_owned),
            dataset: None,
            view: 0,
            storage: Storage::default(),
        }
    }

    /// Loads or makes the scene. `training`: true to train it, on a data set's photos if there is one.
    pub fn load(&self, training: bool, host: &HostArguments) -> Result<Scene> {
        self.check(training)?;
        let mut scene = match (&self.dataset, &self.scene) {
            (Some(dataset), trained) => self.of_dataset(dataset, trained.as_deref(), training, host)?,
            (None, Some(trained)) => {
                let splats::Scene { gaussians, frame, .. } = splats::read(trained, &host.reading(true))?;
                let camera = match &self.camera {
                    Some(place) => named_camera(place, &frame)?,
                    None => overview(&gaussians),
                };
                let source = trained.display().to_string();
                Scene { gaussians, camera, view: None, scene_extent: 1.0, storage: self.storage, source }
            }
            (None, None) => return Ok(Scene { storage: self.storage, ..self.synthetic.load()? }),
        };
        let (own_width, own_height) = (scene.camera.width, scene.camera.height);
        let width = self.synthetic.width.unwrap_or(own_width);
        let height = self.synthetic.height.unwrap_or(own_height);
        if scene.view.is_some() && (width, height) != (own_width, own_height) {
            return Err(Error::argument("--width/--height", "cannot change a data set's photos"));
        }
        scene.camera = scene.camera.fitted_to(width, height);
        scene.checked()
    }

    /// Refuses options of a synthetic scene if a scene is given.
    fn check(&self, training: bool) -> Result<()> {
        let SyntheticArguments { gaussians, sh_degree, seed, .. } = &self.synthetic;
        let giver = match (&self.scene, &self.dataset) {
            (Some(_), _) => "--scene",
            (None, Some(_)) => "--dataset",
            (None, None) => return Ok(()),
        };
        // A data set's points have no spherical harmonics; training without photos starts from a disturbed scene.
        let unused = [
            ("--gaussians", gaussians.is_some()),
            ("--sh-degree", sh_degree.is_some() && self.scene.is_some()),
            ("--seed", seed.is_some() && !(training && self.dataset.is_none())),
        ];
        match unused.iter().find(|(_, given)| *given) {
            Some((option, _)) => {
                Err(Error::argument(*option, format!("is of synthetic scenes; leave it or {giver} out")))
            }
            None => Ok(()),
        }
    }

    fn of_dataset(
        &self,
        dataset: &Path,
        trained: Option<&Path>,
        photos: bool,
        host: &HostArguments,
    ) -> Result<Scene> {
        let mut source = dataset.display().to_string();
        let no_view = |views: usize| {
            Error::argument(
                format!("--view {}", self.view),
                format!("the data set has {views} views, from 0"),
            )
        };
        let (camera, view, points, scene_extent, frame) = if photos || trained.is_none() {
            let options = DatasetOptions { host_memory: host.memory(), ..Default::default() };
            let loaded = Dataset::load(dataset, &options, Progress::default())?;
            let count = loaded.train.len();
            let view = loaded.train.into_iter().nth(self.view).ok_or_else(|| no_view(count))?;
            let camera = view.camera;
            let view = photos.then_some(TrainView::new(camera, view.photo));
            (camera, view, Some(loaded.points), loaded.scene_extent, loaded.frame)
        } else {
            let gallery = Gallery::open(dataset, &DatasetOptions::default(), Progress::default())?;
            let cameras = gallery.cameras();
            let camera = cameras.get(self.view).ok_or_else(|| no_view(cameras.len()))?.camera;
            (camera, None, None, 1.0, *gallery.frame())
        };
        let gaussians = match (trained, points) {
            (Some(trained), _) => {
                source = format!("{} in {source}", trained.display());
                let mut scene = splats::read(trained, &host.reading(true))?;
                scene.express_in(&frame);
                scene.gaussians
            }
            (None, points) => {
                ashsplat_files::initial_gaussians(&points.unwrap_or_default(), self.synthetic.sh_degree())?
            }
        };
        Ok(Scene { gaussians, camera, view, scene_extent, storage: self.storage, source })
    }
}

fn named_camera(place: &str, frame: &WorldFrame) -> Result<Camera> {
    let (file, index) = match place.rsplit_once(':') {
        Some((file, index)) if !index.is_empty() && index.bytes().all(|b| b.is_ascii_digit()) => {
            (file, index.parse().unwrap_or(usize::MAX))
        }
        _ => (place, 0),
    };
    let cameras = cameras_json::read(file, frame)?;
    let found = cameras.get(index).map(|named| named.camera);
    found.ok_or_else(|| Error::input(file, format!("has {} cameras, not number {index}", cameras.len()), ""))
}

/// A camera that sees the middle nine tenths of a scene.
fn overview(gaussians: &Gaussians) -> Camera {
    let intrinsics = Intrinsics::from_fov_x(1.0, 960, 540);
    orbit_around(gaussians, Vec3::NEG_Y, 1, intrinsics).cameras().swap_remove(0)
}

impl Scene {
    fn checked(self) -> Result<Self> {
        if self.gaussians.is_empty() {
            return Err(Error::argument("scene", "has no Gaussians; give --gaussians 1 or more"));
        }
        self.camera.check()?;
        Ok(self)
    }

    /// The workload for the result file, with `more` inputs in its hash. The command that renders a frame fills in its counts.
    pub fn workload(&self, settings: &RenderSettings, more: &[u8]) -> Workload {
        let mut hash = Fnv::default();
        let (g, c) = (&self.gaussians, &self.camera);
        hash.gaussians(g);
        hash.camera(c);
        hash.add(format!("{settings:?}").as_bytes());
        hash.add(more);
        if let Some(view) = &self.view {
            // The photo is in memory, so this cannot fail.
            if let Ok(photo) = view.photo.photo() {
                hash.add(&photo.rgb);
            }
        }
        Workload {
            source: format!("{}{}", self.source, self.storage.note()),
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
        // Pinhole cameras keep the hashes of older files.
        if c.is_orthographic() {
            self.add(b"orthographic");
        }
    }

    pub fn hex(&self) -> String {
        format!("{:016x}", self.0)
    }
}
