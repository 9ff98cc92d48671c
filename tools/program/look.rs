//! How scenes are drawn: options, their settings, and a default orbit.

use crate::args::HostArguments;
use crate::config::Settings;
use ashsplat::kernels::constants::NEAR_PLANE;
use ashsplat::scene::{Camera, Gaussians, Intrinsics, Orbit};
use ashsplat::{Error, Extent, RenderSettings, Result, ShStorage};
use ashsplat_files::splats::{self, ReadOptions, Target};
use ashsplat_files::text::numbers;
use ashsplat_files::tiles::{TILESET_FILE, Tree};
use clap::Args;
use glam::Vec3;
use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::path::Path;

/// How a scene is drawn.
#[derive(Args)]
pub struct LookArguments {
    /// Drop the Gaussians whose parameters are not finite, instead of refusing it
    #[arg(long)]
    pub drop_invalid: bool,
    /// Background colour, 0 to 1 [default: as in training, else black]
    #[arg(long, value_name = "R,G,B", allow_hyphen_values = true, value_parser = parse_color)]
    background: Option<Vec3>,
    /// SH degree to draw [default: all that the file has]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=3))]
    sh_degree: Option<u32>,
    /// Where a Gaussian ends: at alpha 1/255, or at the reference renderer's tile square
    #[arg(long, value_parser = ["exact", "reference"], value_name = "EXTENT", default_value = "exact")]
    extent: String,
    /// Compensate the opacity for the screen-space dilation (Mip-Splatting) [default: as in training, or as the file says]
    #[arg(long)]
    antialiasing: bool,
    /// Blend in the order of distances instead of z, so that colours do not pop when the camera turns [default: as in training]
    #[arg(long)]
    distance_order: bool,
    /// Low-pass filter: variance added on the screen, square pixels [default: as in training, or as the file says, else 0.3]
    #[arg(long, value_name = "PX2")]
    kernel_size: Option<f32>,
    /// Storage of SH on the device: halves and bytes are rounded, unless the file has such values [default: the smallest that is exact]
    #[arg(long, value_name = "STORAGE", value_parser = parse_sh_storage)]
    pub sh_storage: Option<ShStorage>,
}

impl LookArguments {
    pub fn stored(&self, gaussians: &Gaussians) -> ShStorage {
        stored(self.sh_storage, gaussians)
    }

    /// Reads the Gaussians in their drawing frame; reports dropped ones and oddities on stderr.
    pub fn load(&self, path: &Path, host: &HostArguments) -> Result<splats::Scene> {
        let scene = splats::read(path, &host.reading(self.drop_invalid))?;
        Ok(reported(path, scene.in_world_frame()))
    }

    /// The settings of the training, overridden by the file, overridden by the arguments.
    pub fn settings(&self, trained: &Settings, header: &splats::Header) -> Result<RenderSettings> {
        let mut settings = render_settings_of(trained, header);
        if let Some(background) = self.background {
            settings.background = background.to_array();
        }
        settings.sh_degree = self.sh_degree;
        settings.antialias |= self.antialiasing;
        settings.distance_order |= self.distance_order;
        if let Some(kernel_size) = self.kernel_size {
            if !(kernel_size > 0.0 && kernel_size <= MAX_KERNEL_SIZE) {
                let problem = format!(
                    "{kernel_size} is not a positive number up to {MAX_KERNEL_SIZE}: the reference has 0.3, Mip-Splatting 0.1"
                );
                return Err(Error::argument("--kernel-size", problem));
            }
            settings.dilation_px2 = kernel_size;
        }
        settings.extent = if self.extent == "exact" { Extent::Exact } else { Extent::Reference };
        Ok(settings)
    }
}

/// Largest accepted `--kernel-size`, square pixels.
const MAX_KERNEL_SIZE: f32 = 1e4;
/// Reports what was dropped from a scene or is odd about it, and returns the scene.
pub fn reported(path: &Path, scene: splats::Scene) -> splats::Scene {
    if scene.dropped > 0 {
        errln!("{}: dropped {} Gaussians that are not finite", path.display(), scene.dropped);
    }
    for warning in &scene.warnings {
        errln!("{}: {warning}", path.display());
    }
    scene
}

/// The settings with which training drew the scene.
pub fn settings_of(trained: &Settings) -> RenderSettings {
    // Reading a scene has already applied its 3D filter.
    RenderSettings { filter_3d: false, ..trained.train.render_settings() }
}

/// The settings with which training drew the scene, by its settings and its file.
pub fn render_settings_of(trained: &Settings, header: &splats::Header) -> RenderSettings {
    let look = settings_of(trained);
    let dilation_px2 = header.kernel_size.unwrap_or(look.dilation_px2);
    let distance_order = look.distance_order || header.distance_order;
    RenderSettings { antialias: look.antialias || header.antialiased, dilation_px2, distance_order, ..look }
}

/// Parses three comma-separated numbers.
fn parse_vector(text: &str) -> Result<Vec3, String> {
    let vector = numbers(text).map(Vec3::from_array).filter(|vector| vector.is_finite());
    vector.ok_or_else(|| "expected three numbers with commas between them".into())
}

/// Parses a direction in the world: any three numbers that are not all 0.
pub fn parse_direction(text: &str) -> Result<Vec3, String> {
    match parse_vector(text)?.as_dvec3().try_normalize() {
        Some(direction) => Ok(direction.as_vec3()),
        None => Err("expected a direction: three numbers that are not all 0".into()),
    }
}

/// Returns the wanted storage of SH, otherwise the smallest that is exact.
pub fn stored(requested: Option<ShStorage>, gaussians: &Gaussians) -> ShStorage {
    requested.unwrap_or_else(|| ShStorage::lossless(gaussians))
}

pub fn parse_sh_storage(text: &str) -> Result<ShStorage, String> {
    match text {
        "f32" => Ok(ShStorage::F32),
        "half" => Ok(ShStorage::Half),
        "bytes" => Ok(ShStorage::Bytes),
        _ => Err("expected f32, half or bytes".into()),
    }
}

/// Parses a colour with channels from 0 to 1.
fn parse_color(text: &str) -> Result<Vec3, String> {
    let color = parse_vector(text)?;
    let sound = color.min_element() >= 0.0 && color.max_element() <= 1.0;
    if sound { Ok(color) } else { Err("expected three numbers from 0 to 1".into()) }
}

/// The tree of tiles of a folder in its drawing frame, if there is one. A budget requires it.
pub fn tree_of(folder: &Path, has_budget: bool) -> Result<Option<Tree>> {
    if folder.join(TILESET_FILE).is_file() {
        return Tree::open(folder).map(|tree| Some(tree.in_world_frame()));
    }
    let problem = "is for folders of tiles, as `ashsplat tiles` writes them";
    if has_budget { Err(Error::argument("--budget", problem)) } else { Ok(None) }
}

/// Number of Gaussians of a budget.
pub fn gaussians_of(budget: Target, tree: &Tree) -> usize {
    match budget {
        Target::Count(count) => usize::try_from(count).unwrap_or(usize::MAX),
        Target::Share(share) => (share * tree.gaussians() as f64).round() as usize,
    }
}

pub fn parse_target(text: &str) -> Result<Target, String> {
    let problem = || "expected a number above 0, or 0 to 100 with %".to_owned();
    match text.strip_suffix('%') {
        Some(percent) => match percent.trim().parse::<f64>() {
            Ok(percent) if (0.0..=100.0).contains(&percent) && percent > 0.0 => {
                Ok(Target::Share(percent / 100.0))
            }
            _ => Err(problem()),
        },
        None => text.parse().ok().filter(|&count| count > 0).map(Target::Count).ok_or_else(problem),
    }
}

/// Share of the middle part's diagonal that an orbit shows; corners may be cut.
const ORBIT_SHARE: f32 = 0.75;
/// Reach of a Gaussian beyond its mean for an orbit, standard deviations.
const ORBIT_REACH: f32 = 2.0;

/// A circle around the middle nine tenths of the Gaussians, wide enough to see nearly all of them and not so near that
/// any are culled.
pub fn orbit_around(gaussians: &Gaussians, up: Vec3, count: u32, intrinsics: Intrinsics) -> Orbit {
    let statistics = gaussians.statistics();
    let bounds = statistics.central_bounds;
    let center = bounds.map_or(Vec3::ZERO, |b| b.center());
    let median_scale = statistics.scale_percentiles.map_or(0.0, |percentiles| percentiles[3]);
    let half_diagonal = bounds.map_or(1.0, |b| 0.5 * b.size().length()) + ORBIT_REACH * median_scale;
    let ball = half_diagonal.max(1e-3) * ORBIT_SHARE;
    let narrow = intrinsics.width.min(intrinsics.height) as f32;
    // Sine of half the narrower field of view, at which the ball just fits.
    let sine = f64::from(0.5 * narrow / intrinsics.fx).atan().sin() as f32;
    let radius = (ball / sine).max(NEAR_PLANE + ball);
    Orbit { center, up, radius, elevation: 20f32.to_radians(), count, intrinsics }
}

pub const NOTHING_SHOWN: &str =
    "no picture shows a Gaussian: do scene and cameras have the same coordinates?";

/// A tree that is drawn within a budget of Gaussians. It holds the tiles of the last picture.
pub struct BudgetedTree {
    tree: Tree,
    budget: usize,
    read: ReadOptions,
    loaded: BTreeMap<usize, Gaussians>,
}

impl BudgetedTree {
    pub fn new(tree: Tree, budget: usize, read: ReadOptions) -> BudgetedTree {
        BudgetedTree { tree, budget, read, loaded: BTreeMap::new() }
    }

    /// The Gaussians for a camera; `None` if they are those of the last one.
    pub fn changed_gaussians(&mut self, camera: &Camera) -> Result<Option<Gaussians>> {
        let cut = self.tree.cut(camera, self.budget);
        if !self.loaded.is_empty() && self.loaded.keys().eq(&cut) {
            return Ok(None);
        }
        self.loaded.retain(|tile, _| cut.contains(tile));
        for tile in cut {
            if let Entry::Vacant(place) = self.loaded.entry(tile) {
                place.insert(self.tree.read(tile, &self.read)?.gaussians);
            }
        }
        let sh_degree = self.loaded.values().map(|tile| tile.sh_degree).max().unwrap_or(0);
        let count = self.loaded.values().map(Gaussians::len).sum();
        let mut all = Gaussians::with_capacity(sh_degree, count);
        self.loaded.values().for_each(|tile| all.append(tile));
        Ok(Some(all))
    }
}
