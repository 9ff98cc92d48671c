//! `ashsplat render`, and how pictures are asked for on the command line.

use crate::args::{DeviceArguments, HostArguments};
use crate::config::{CAMERAS_FILE, Settings};
use crate::model::Model;
use crate::{output, session};
use ashsplat::kernels::constants::NEAR_PLANE;
use ashsplat::scene::{Camera, Gaussians, Intrinsics, Orbit};
use ashsplat::{Error, Extent, Frame, RenderSettings, Renderer, Result};
use ashsplat_files::cameras_json::{self, NamedCamera};
use ashsplat_files::splats;
use clap::{Args, ValueEnum};
use glam::Vec3;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Render a trained scene: by default the views of its training, else a data set's, an orbit or a camera path.
///
/// EXR files hold linear light (R G B: the sRGB curve of the photographs undone), A = 1 - transmittance, and
/// Z = expected depth = (1 - transmittance) / sum(alpha T / z), infinite where nothing was blended.
///
/// A camera path is a JSON list in the format of a model folder's cameras.json: [{"id", "img_name", "width",
/// "height", "position": [x, y, z], "rotation": 3 rows of the rotation from camera (x right, y down, z forward) to
/// world, "fx", "fy", and optionally "cx", "cy"}, ...], lengths in pixels, the first pixel's centre at 0.5.
#[derive(Args)]
pub struct Arguments {
    /// A model folder or a file of Gaussians (PLY, compressed PLY, .splat, SPZ, glTF)
    #[arg(value_name = "MODEL", required_unless_present = "model_path")]
    model: Option<PathBuf>,
    /// The same, under the reference's name
    #[arg(short, long, value_name = "MODEL", conflicts_with = "model")]
    model_path: Option<PathBuf>,
    /// Iteration of the model folder's PLY [default: what was saved last]
    #[arg(long, value_name = "N")]
    iteration: Option<u32>,
    /// Render all views of this data set
    #[arg(short, long, value_name = "DATASET", conflicts_with_all = ["orbit", "path"])]
    source_path: Option<PathBuf>,
    /// Render N views in a circle around the scene
    #[arg(long, value_name = "N", conflicts_with = "path", value_parser = clap::value_parser!(u32).range(1..))]
    orbit: Option<u32>,
    /// Render the views of a camera path (JSON)
    #[arg(long, value_name = "FILE")]
    path: Option<PathBuf>,
    /// Up in an orbit's pictures, for a PLY without cameras
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = parse_vector, default_value = "0,-1,0")]
    up: Vec3,
    /// Folder for the pictures
    #[arg(short, long, value_name = "DIR", default_value = "out/render")]
    out: PathBuf,
    /// Which files to write
    #[arg(long, value_enum, default_value = "png")]
    format: Format,
    #[command(flatten)]
    size: SizeArguments,
    #[command(flatten)]
    look: LookArguments,
    #[command(flatten)]
    device: DeviceArguments,
    /// Print only errors
    #[arg(long)]
    quiet: bool,
}

/// File formats of pictures.
#[derive(Clone, Copy, PartialEq, ValueEnum)]
enum Format {
    /// 8 bits per channel
    Png,
    /// 32-bit float: linear colour, alpha and depth
    Exr,
    /// PNG and EXR
    Both,
}

/// Size and field of view, where they differ from the cameras' own.
#[derive(Args)]
pub struct SizeArguments {
    /// Width of the pictures, pixels [default: the cameras'; 1280 for an orbit]
    #[arg(long, value_name = "PIXELS")]
    width: Option<u32>,
    /// Height of the pictures, pixels [default: the cameras'; 720 for an orbit]
    #[arg(long, value_name = "PIXELS")]
    height: Option<u32>,
    /// Horizontal field of view, degrees [default: the cameras'; 60 for an orbit]
    #[arg(long, value_name = "DEGREES")]
    fov: Option<f32>,
}

/// How a scene is drawn.
#[derive(Args)]
pub struct LookArguments {
    /// Drop the Gaussians whose parameters are not finite, instead of refusing it
    #[arg(long)]
    drop_invalid: bool,
    /// Background colour, 0 to 1 [default: as in training, else black]
    #[arg(long, value_name = "R,G,B", value_parser = parse_vector)]
    background: Option<Vec3>,
    /// SH degree to draw [default: all that the file has]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=3))]
    sh_degree: Option<u32>,
    /// Where a Gaussian ends: at alpha 1/255, or at the reference renderer's tile square
    #[arg(long, value_enum, default_value = "exact")]
    extent: ExtentName,
    /// Compensate the opacity for the screen-space dilation (Mip-Splatting) [default: as in training, or as the file says]
    #[arg(long)]
    antialiasing: bool,
}

#[derive(Clone, Copy, ValueEnum)]
enum ExtentName {
    Exact,
    Reference,
}

impl LookArguments {
    /// Reads the Gaussians; tells on stderr what was dropped or is odd.
    pub fn load(&self, path: &Path, host: &HostArguments) -> Result<splats::Scene> {
        let scene = splats::read(path, &host.reading(self.drop_invalid))?;
        if scene.dropped > 0 {
            tell!("{}: dropped {} Gaussians that are not finite", path.display(), scene.dropped);
        }
        for warning in &scene.warnings {
            tell!("{}: {warning}", path.display());
        }
        Ok(scene)
    }

    /// The settings: those of the training, changed by what the file says and what was given.
    pub fn settings(&self, trained: &Settings, header: &splats::Header) -> Result<RenderSettings> {
        let mut settings = settings_of(trained);
        if let Some(background) = self.background {
            settings.background = background.to_array();
        }
        settings.sh_degree = self.sh_degree;
        settings.antialias |= self.antialiasing || header.antialiased;
        settings.extent = match self.extent {
            ExtentName::Exact => Extent::Exact,
            ExtentName::Reference => Extent::Reference,
        };
        Ok(settings)
    }
}

/// How a scene was drawn in its training.
pub fn settings_of(trained: &Settings) -> RenderSettings {
    let background = if trained.train.white_background { [1.0; 3] } else { [0.0; 3] };
    RenderSettings { background, antialias: trained.train.antialiasing, ..Default::default() }
}

/// Three numbers with commas between them.
pub fn parse_vector(text: &str) -> Result<Vec3, String> {
    let numbers: Result<Vec<f32>, _> = text.split(',').map(|part| part.trim().parse()).collect();
    match numbers.ok().and_then(|n| <[f32; 3]>::try_from(n).ok()) {
        Some(vector) if vector.iter().all(|v| v.is_finite()) => Ok(Vec3::from_array(vector)),
        _ => Err("expected three numbers with commas between them".into()),
    }
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> Result<()> {
    let path = arguments.model.as_ref().or(arguments.model_path.as_ref());
    let path = path.ok_or_else(|| Error::argument("MODEL", "is missing"))?;
    let model = Model::locate(path, arguments.iteration)?;
    let scene = arguments.look.load(&model.ply, &arguments.device.host)?;
    let gaussians = &scene.gaussians;
    let cameras = arguments.cameras(&model, gaussians)?;
    let with_depth = arguments.format != Format::Png;
    let settings = RenderSettings {
        inverse_depth: with_depth,
        ..arguments.look.settings(&model.settings, &scene.header)?
    };
    let context = arguments.device.context()?;
    let mut renderer = Renderer::new(&context)?;
    renderer.upload(gaussians)?;
    output::remove_leftovers(&arguments.out, 0);
    let mut total = 0.0;
    for (index, named) in cameras.iter().enumerate() {
        let start = Instant::now();
        let frame = renderer.render(&named.camera, &settings)?;
        let milliseconds = start.elapsed().as_secs_f64() * 1e3;
        total += milliseconds;
        arguments.save(index, &frame)?;
        if !arguments.quiet {
            say!("{}", describe(index, &named.name, milliseconds, &frame));
        }
    }
    if !arguments.quiet {
        let (count, mean) = (cameras.len(), total / cameras.len() as f64);
        say!("{count} frames in {}, {mean:.1} ms each on {}", arguments.out.display(), context.device_name());
    }
    arguments.device.report_validation(&context);
    Ok(())
}

fn describe(index: usize, name: &str, milliseconds: f64, frame: &Frame) -> String {
    let stats = &frame.stats;
    format!(
        "{index:05} {name} {}x{}: {milliseconds:.1} ms, {} of {} Gaussians visible, {} instances, longest tile {}",
        frame.width, frame.height, stats.visible, stats.gaussians, stats.instances, stats.longest_tile
    )
}

impl Arguments {
    fn save(&self, index: usize, frame: &Frame) -> Result<()> {
        if self.format != Format::Exr {
            output::write_png(&output::numbered(&self.out, index, "png"), &output::to_photo(frame)?)?;
        }
        if self.format != Format::Png {
            output::write_exr(&output::numbered(&self.out, index, "exr"), frame)?;
        }
        Ok(())
    }

    /// The views to render.
    fn cameras(&self, model: &Model, gaussians: &Gaussians) -> Result<Vec<NamedCamera>> {
        let own =
            model.folder.as_ref().map(|(folder, _)| folder.join(CAMERAS_FILE)).filter(|path| path.is_file());
        if let Some(count) = self.orbit {
            return self.orbit_cameras(count, own.as_deref(), gaussians);
        }
        let mut cameras = match (&self.source_path, &self.path, own) {
            (Some(dataset), _, _) => session::cameras(dataset)?,
            (None, Some(path), _) => cameras_json::read(path)?,
            (None, None, Some(path)) => cameras_json::read(path)?,
            (None, None, None) => {
                return Err(Error::input(
                    &model.ply,
                    "has no cameras beside it",
                    "give -s DATASET, --orbit N or --path FILE",
                ));
            }
        };
        for named in &mut cameras {
            named.camera = self.size.applied_to(&named.camera)?;
        }
        Ok(cameras)
    }

    /// A circle like that of the training's cameras, or around the Gaussians where there are none.
    fn orbit_cameras(
        &self,
        count: u32,
        own: Option<&Path>,
        gaussians: &Gaussians,
    ) -> Result<Vec<NamedCamera>> {
        let fov = self.size.fov.unwrap_or(60.0).to_radians();
        let intrinsics =
            Intrinsics::from_fov_x(fov, self.size.width.unwrap_or(1280), self.size.height.unwrap_or(720));
        let trained = match own {
            Some(path) => cameras_json::read(path)?.iter().map(|named| named.camera).collect(),
            None => Vec::new(),
        };
        let scene_center = gaussians.statistics().central_bounds.map(|bounds| bounds.center());
        let orbit = Orbit::around_scene(&trained, scene_center, count, intrinsics);
        let orbit = orbit.unwrap_or_else(|| orbit_around(gaussians, self.up, count, intrinsics));
        let named = |(index, camera): (usize, Camera)| {
            camera.check()?;
            Ok(NamedCamera { name: format!("orbit_{index:03}"), camera })
        };
        orbit.cameras().into_iter().enumerate().map(named).collect()
    }
}

/// How much of the middle part's diagonal an orbit shows: corners may be cut.
const ORBIT_SHARE: f32 = 0.75;
/// Standard deviations that a Gaussian reaches beyond its mean, in an orbit's sense.
const ORBIT_REACH: f32 = 2.0;

/// A circle around the middle nine tenths of the Gaussians, far enough to see nearly all of them, and none so near
/// that it would be culled.
pub fn orbit_around(gaussians: &Gaussians, up: Vec3, count: u32, intrinsics: Intrinsics) -> Orbit {
    let statistics = gaussians.statistics();
    let bounds = statistics.central_bounds;
    let center = bounds.map_or(Vec3::ZERO, |b| b.center());
    let median_scale = statistics.scale_percentiles.map_or(0.0, |percentiles| percentiles[3]);
    let half_diagonal = bounds.map_or(1.0, |b| 0.5 * b.size().length()) + ORBIT_REACH * median_scale;
    let ball = half_diagonal.max(1e-3) * ORBIT_SHARE;
    let narrow = intrinsics.width.min(intrinsics.height) as f32;
    // sin of half the narrower field of view: the ball just fits.
    let sine = (0.5 * narrow / intrinsics.fx).atan().sin();
    let radius = (ball / sine).max(NEAR_PLANE + ball);
    Orbit { center, up, radius, elevation: 20f32.to_radians(), count, intrinsics }
}

impl SizeArguments {
    /// The camera at the size and field of view asked for; one of width and height alone keeps the aspect.
    fn applied_to(&self, camera: &Camera) -> Result<Camera> {
        let scaled = |size: u32, by: u32, of: u32| {
            ((f64::from(size) * f64::from(by) / f64::from(of)).round() as u32).max(1)
        };
        let (width, height) = match (self.width, self.height) {
            (Some(width), Some(height)) => (width, height),
            (Some(width), None) => (width, scaled(camera.height, width, camera.width)),
            (None, Some(height)) => (scaled(camera.width, height, camera.height), height),
            (None, None) => (camera.width, camera.height),
        };
        let mut camera = camera.scaled_to(width, height);
        if let Some(fov) = self.fov {
            let focal = Intrinsics::from_fov_x(fov.to_radians(), width, height).fx;
            camera.fy *= focal / camera.fx;
            camera.fx = focal;
        }
        camera.check()?;
        Ok(camera)
    }
}
