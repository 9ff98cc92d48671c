//! Chooses the views that `ashsplat render` renders.

use ashsplat::scene::{Camera, Intrinsics, Motion, Orbit, PhotoLens, WorldFrame, tour};
use ashsplat::{Error, Result};
use ashsplat_files::Gallery;
use ashsplat_files::cameras_json::{self, NamedCamera};
use ashsplat_files::splats::Scene;
use ashsplat_program::config::CAMERAS_FILE;
use ashsplat_program::film_file::Container;
use ashsplat_program::look::{orbit_around, parse_direction};
use ashsplat_program::model::{Model, POINT_CLOUDS};
use ashsplat_program::session;
use clap::{Args, ValueEnum};
use glam::Vec3;
use std::cmp::Ordering;
use std::path::{Path, PathBuf};

/// Largest number of views of an orbit or a curve: an hour of film at 28 frames per second.
const MAX_FRAMES: i64 = 100_000;
const FILM_FRAMES: u32 = 240;

/// The views.
#[derive(Args)]
pub struct Arguments {
    /// Render all views of this data set
    #[arg(short, long, value_name = "DATASET", conflicts_with_all = ["orbit", "path", "motion"])]
    pub source_path: Option<PathBuf>,
    /// Render N views around the scene, where the cameras of the training saw it [default for films: 240]
    #[arg(long, value_name = "N", conflicts_with = "path", value_parser = clap::value_parser!(u32).range(1..=MAX_FRAMES))]
    orbit: Option<u32>,
    /// How an orbit moves: in a full circle (orbit), the part of it in which there are cameras (arc), or a smooth curve along the cameras
    /// (path) [default: as suits the training's cameras]
    #[arg(long, value_parser = ["orbit", "arc", "path"], value_name = "NAME", conflicts_with = "path")]
    motion: Option<String>,
    /// Render the views of a camera path (JSON)
    #[arg(long, value_name = "FILE")]
    path: Option<PathBuf>,
    /// Render N views on a smooth curve through those of --path; a model folder's cameras.json is sorted by name, another
    /// file keeps its order
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=MAX_FRAMES))]
    frames: Option<u32>,
    /// Up direction of an orbit for a PLY without cameras [default: 0,-1,0]
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = parse_direction)]
    up: Option<Vec3>,
    #[command(flatten)]
    size: SizeArguments,
}

fn parse_fov(text: &str) -> Result<f32, String> {
    match text.parse() {
        Ok(degrees) if (0.01..=360.0).contains(&degrees) => Ok(degrees),
        _ => Err("expected degrees, 0.01 to 179, with a fisheye to 360".into()),
    }
}

/// Widest field of view of a pinhole, degrees.
const WIDEST: f32 = 179.0;

/// A lens in place of the cameras' own, by COLMAP's name.
#[derive(Clone, Copy, PartialEq, ValueEnum)]
enum Lens {
    /// A panorama of all directions
    #[value(name = "EQUIRECTANGULAR")]
    Panorama,
    /// A fisheye without distortion that shows --fov, 180, from left to right
    #[value(name = "OPENCV_FISHEYE")]
    Fisheye,
}

/// Size and field of view, where they differ from the cameras' own.
#[derive(Args)]
pub struct SizeArguments {
    /// Width of the pictures, pixels; a picture of another aspect than its camera's shows more at two sides [default: the cameras';
    /// 1280 for an orbit, 640 as a GIF; 720 and 360 where most photographs are upright]
    #[arg(long, value_name = "PIXELS")]
    width: Option<u32>,
    /// Height of the pictures, pixels [default: the cameras', with --width in their aspect; for an orbit 9/16 of the width, 16/9
    /// where most photographs are upright]
    #[arg(long, value_name = "PIXELS")]
    height: Option<u32>,
    /// Horizontal field of view, degrees [default: the cameras'; for an orbit as much as they show, at most 60]
    #[arg(long, value_name = "DEGREES", allow_hyphen_values = true, value_parser = parse_fov)]
    fov: Option<f32>,
    /// Lens of the pictures [default: the cameras' own]
    #[arg(long, value_enum, ignore_case = true)]
    camera_model: Option<Lens>,
}

pub struct Views {
    pub cameras: Vec<NamedCamera>,
    /// Lens of each photograph, which the arguments may have replaced in its camera; empty for orbits.
    pub lenses: Vec<PhotoLens>,
    pub note: Option<String>,
}

impl Arguments {
    pub fn check(&self) -> Result<()> {
        match (self.frames, &self.path) {
            (Some(count), None) => {
                let problem = format!(
                    "needs a camera path: --path FILE; `--orbit {count}` has {count} views around the scene"
                );
                Err(Error::argument("--frames", problem))
            }
            _ => Ok(()),
        }
    }

    /// True for the training's views, which no argument replaces.
    pub fn are_of_training(&self) -> bool {
        let others =
            [self.source_path.is_some(), self.path.is_some(), self.orbit.is_some(), self.motion.is_some()];
        others == [false; 4]
    }

    fn motion(&self) -> Option<Motion> {
        Some(match self.motion.as_deref()? {
            "orbit" => Motion::Orbit,
            "arc" => Motion::Arc,
            _ => Motion::Path,
        })
    }

    /// Chooses the views. `gallery` is the data set, if it is open already: a model with cameras of its own takes only masks from it.
    pub fn choose(
        &self,
        model: &Model,
        scene: &Scene,
        gallery: Option<&Gallery>,
        film: Option<Container>,
    ) -> Result<Views> {
        let own = model.cameras_file();
        let unsaid = film.is_some() && self.source_path.is_none() && self.path.is_none();
        if let Some(count) = self.orbit.or_else(|| (unsaid || self.motion.is_some()).then_some(FILM_FRAMES)) {
            return self.around(count, own.as_deref(), scene, film);
        }
        if self.up.is_some() {
            return Err(Error::argument("--up", "is for orbits (--orbit N): these cameras have their own"));
        }
        let mut cameras = match (&self.source_path, &self.path, own) {
            (Some(dataset), _, _) if gallery.is_none() => {
                session::cameras(dataset, &model.settings.data, &scene.frame)?
            }
            (_, Some(path), _) => self.along(path, &scene.frame)?,
            (_, None, Some(path)) => cameras_json::read(path, &scene.frame)?,
            (Some(_), None, None) if let Some(gallery) = gallery => gallery.cameras(),
            (_, None, None) => {
                return Err(Error::input(
                    &model.ply,
                    "has no cameras beside it",
                    "give -s DATASET, --orbit N or --path FILE",
                ));
            }
        };
        if cameras.is_empty() {
            let place = self.path.as_ref().or(self.source_path.as_ref()).unwrap_or(&model.ply);
            return Err(Error::input(place, "has no cameras", "give one with a view at least"));
        }
        let note = self.widening(&cameras);
        let lenses = cameras.iter().map(|named| named.camera.photo_lens()).collect();
        for named in &mut cameras {
            named.camera = self.size.applied_to(&named.camera)?;
        }
        let size = |named: &NamedCamera| (named.camera.width, named.camera.height);
        if let Some(other) = cameras.iter().find(|named| film.is_some() && size(named) != size(&cameras[0])) {
            let [(w, h), (x, y)] = [size(&cameras[0]), size(other)];
            let problem = format!("the views of a film have one size: {w}x{h} and {x}x{y} ({})", other.name);
            return Err(Error::argument("--out", format!("{problem}; give --width and --height")));
        }
        Ok(Views { cameras, lenses, note })
    }

    /// A note if pictures of another aspect show more than their cameras.
    fn widening(&self, cameras: &[NamedCamera]) -> Option<String> {
        let (NamedCamera { name, camera }, [width, height]) = cameras.iter().find_map(|named| {
            let size = self.size.of(&named.camera);
            (!named.camera.keeps_aspect_at(size[0], size[1])).then_some((named, size))
        })?;
        let (w, h) = (camera.width, camera.height);
        let wider = u64::from(width) * u64::from(h) > u64::from(height) * u64::from(w);
        let sides = if wider { "at the left and right" } else { "above and below" };
        // --fov determines how much a picture shows, so there is nothing to note.
        (self.size.fov.is_none() && self.size.camera_model.is_none()).then(|| {
            format!("{width}x{height} shows more {sides} than {w}x{h} ({name}): pixels keep their shape")
        })
    }

    /// The views of a camera path, or views on a curve through them.
    fn along(&self, path: &Path, frame: &WorldFrame) -> Result<Vec<NamedCamera>> {
        let mut keys = cameras_json::read(path, frame)?;
        let Some(count) = self.frames else { return Ok(keys) };
        // Training lists held-out views first; names give the order of the photographs.
        if is_of_model(path) {
            keys.sort_by(|a, b| by_name(&a.name, &b.name));
        }
        if let Some(pair) =
            keys.windows(2).find(|pair| pair[0].camera.projection != pair[1].camera.projection)
        {
            let problem = format!(
                "{} is {} and {} {}: nothing lies between them",
                pair[0].name,
                pair[0].camera.projection.name(),
                pair[1].name,
                pair[1].camera.projection.name()
            );
            return Err(Error::input(path, problem, "leave out --frames, or give keys of one kind"));
        }
        let keys: Vec<Camera> = keys.iter().map(|named| named.camera).collect();
        named(tour::through_keys(&keys, count, false), "path")
    }

    /// Views within the range of the training's cameras, or a circle around the Gaussians if there are no cameras.
    fn around(
        &self,
        count: u32,
        own: Option<&Path>,
        scene: &Scene,
        film: Option<Container>,
    ) -> Result<Views> {
        let seen: Vec<Camera> = match own {
            // An orbit has an angle of view, which orthographic cameras lack.
            Some(path) => {
                let all = cameras_json::read(path, &scene.frame)?;
                all.iter().map(|named| named.camera).filter(|camera| !camera.is_orthographic()).collect()
            }
            None => Vec::new(),
        };
        let intrinsics = self.size.of_orbit(&seen, film)?;
        if seen.is_empty() && self.motion().is_some_and(|motion| motion != Motion::Orbit) {
            return Err(Error::argument(
                "--motion",
                "needs the training's cameras: a model folder with cameras.json",
            ));
        }
        if self.up.is_some() && !seen.is_empty() {
            let cameras = own.unwrap_or(Path::new(CAMERAS_FILE)).display();
            let problem = format!("is for files without cameras: {cameras} says where up is");
            return Err(Error::argument("--up", problem));
        }
        let motion = self.motion().unwrap_or_else(|| Motion::of(&seen));
        let cameras = match motion {
            Motion::Arc | Motion::Path if !seen.is_empty() => {
                motion.cameras(&seen, count, film.is_some(), intrinsics)
            }
            _ => {
                let gaussians = &scene.gaussians;
                let scene_center = gaussians.statistics().central_bounds.map(|bounds| bounds.center());
                let orbit = Orbit::around_scene(&seen, scene_center, count, intrinsics);
                orbit
                    .unwrap_or_else(|| {
                        orbit_around(gaussians, self.up.unwrap_or(Vec3::NEG_Y), count, intrinsics)
                    })
                    .cameras()
            }
        };
        let note = match motion {
            _ if seen.is_empty() => None,
            Motion::Orbit => Some("--motion orbit: a circle around what the cameras look at"),
            Motion::Arc => Some("--motion arc: the cameras look at the scene from one side"),
            Motion::Path => Some("--motion path: along the cameras, which do not look at one place"),
        };
        // A requested motion needs no reason.
        let note = note.filter(|_| self.motion.is_none()).map(str::to_owned);
        let cameras = cameras.iter().map(|camera| self.size.through_lens(*camera)).collect::<Result<_>>()?;
        Ok(Views { cameras: named(cameras, "orbit")?, lenses: Vec::new(), note })
    }
}

/// True if a camera path is the list that a training wrote: a file of that name in a model folder.
fn is_of_model(path: &Path) -> bool {
    let folder = path.parent().unwrap_or(Path::new(""));
    path.file_name().is_some_and(|name| name == CAMERAS_FILE) && folder.join(POINT_CLOUDS).is_dir()
}

/// Compares names so that numbers in them count as numbers.
fn by_name(a: &str, b: &str) -> Ordering {
    fn part(name: &str) -> (&str, &str) {
        let digit = name.starts_with(|c: char| c.is_ascii_digit());
        name.split_at(name.find(|c: char| c.is_ascii_digit() != digit).unwrap_or(name.len()))
    }
    let (mut left, mut right) = (a, b);
    while !left.is_empty() && !right.is_empty() {
        let ((x, left_rest), (y, right_rest)) = (part(left), part(right));
        let numbers = [x, y].iter().all(|part| part.starts_with(|c: char| c.is_ascii_digit()));
        let [x0, y0] = [x, y].map(|part| part.trim_start_matches('0'));
        let order = if numbers { x0.len().cmp(&y0.len()).then_with(|| x0.cmp(y0)) } else { x.cmp(y) };
        if order.is_ne() {
            return order;
        }
        (left, right) = (left_rest, right_rest);
    }
    left.len().cmp(&right.len()).then_with(|| a.cmp(b))
}

fn named(cameras: Vec<Camera>, word: &str) -> Result<Vec<NamedCamera>> {
    let named = |(index, camera): (usize, Camera)| {
        camera.check()?;
        Ok(NamedCamera { name: format!("{word}_{index:03}"), camera })
    };
    cameras.into_iter().enumerate().map(named).collect()
}

/// Widest default field of view of an orbit, degrees.
const WIDEST_ORBIT: f32 = 60.0;

impl SizeArguments {
    /// Size and field of view of an orbit, which shows no more than the training's cameras.
    fn of_orbit(&self, seen: &[Camera], film: Option<Container>) -> Result<Intrinsics> {
        // Upright if most photographs are.
        let upright = 2 * seen.iter().filter(|c| c.height > c.width).count() > seen.len();
        let long = if film == Some(Container::Gif) { 640 } else { 1280 };
        let [wide, high] = match self.camera_model {
            Some(Lens::Panorama) => [2, 1],
            _ if upright => [9, 16],
            _ => [16, 9],
        };
        let of = |side: u32, [to, from]: [u64; 2]| {
            u32::try_from(u64::from(side) * to / from).unwrap_or(u32::MAX).max(1)
        };
        let (width, height) = match (self.width, self.height) {
            (Some(width), Some(height)) => (width, height),
            (Some(width), None) => (width, of(width, [high, wide])),
            (None, Some(height)) => (of(height, [wide, high]), height),
            (None, None) if wide < high => (of(long, [wide, high]), long),
            (None, None) => (long, of(long, [high, wide])),
        };
        // The same solid angle as a photograph, in another shape.
        let shape = width as f32 / height as f32;
        let reach = |c: &Camera| (0.25 * c.width as f32 / c.fx * c.height as f32 / c.fy * shape).sqrt();
        let angle = |c: &Camera| (2.0 * f64::from(reach(c)).atan().to_degrees()) as f32;
        let mut angles: Vec<f32> = seen.iter().map(angle).collect();
        angles.sort_by(f32::total_cmp);
        let usual = angles.get(angles.len() / 2).map_or(WIDEST_ORBIT, |angle| angle.min(WIDEST_ORBIT));
        let fov = self.pinhole_fov()?.unwrap_or(usual);
        Ok(Intrinsics::from_fov_x(fov.to_radians(), width, height))
    }

    /// The requested field of view, unless it is a fisheye's.
    fn pinhole_fov(&self) -> Result<Option<f32>> {
        match self.fov {
            _ if self.camera_model == Some(Lens::Fisheye) => Ok(None),
            Some(_) if self.camera_model == Some(Lens::Panorama) => {
                Err(Error::argument("--fov", "is not for panoramas, which show all directions"))
            }
            Some(fov) if fov > WIDEST => {
                let problem =
                    format!("more than {WIDEST} degrees need a fisheye: --camera-model OPENCV_FISHEYE");
                Err(Error::argument("--fov", problem))
            }
            fov => Ok(fov),
        }
    }

    fn through_lens(&self, camera: Camera) -> Result<Camera> {
        let Some(lens) = self.camera_model else { return Ok(camera) };
        if camera.is_orthographic() {
            return Err(Error::argument("--camera-model", "is not for orthographic cameras"));
        }
        let [width, height] = [camera.width, camera.height].map(f64::from);
        let focal = width / f64::from(self.fov.unwrap_or(180.0)).to_radians();
        let (cx, cy) = (0.5 * width, 0.5 * height);
        // The models' numbers and parameters.
        let drawn = match lens {
            Lens::Panorama => camera.with_colmap_lens(17, &[width, height]),
            Lens::Fisheye => camera.with_colmap_lens(5, &[focal, focal, cx, cy, 0.0, 0.0, 0.0, 0.0]),
        };
        let camera = drawn.unwrap_or(camera);
        camera.check()?;
        Ok(camera)
    }

    /// Width and height of a camera's picture. If only one is given, the aspect is kept.
    fn of(&self, camera: &Camera) -> [u32; 2] {
        let scaled = |size: u32, by: u32, of: u32| {
            ((f64::from(size) * f64::from(by) / f64::from(of)).round() as u32).max(1)
        };
        match (self.width, self.height) {
            (Some(width), None) if self.camera_model == Some(Lens::Panorama) => [width, (width / 2).max(1)],
            (None, height) if self.camera_model == Some(Lens::Panorama) => {
                let height = height.unwrap_or(camera.height);
                [height.saturating_mul(2), height]
            }
            (Some(width), Some(height)) => [width, height],
            (Some(width), None) => [width, scaled(camera.height, width, camera.width)],
            (None, Some(height)) => [scaled(camera.width, height, camera.height), height],
            (None, None) => [camera.width, camera.height],
        }
    }

    fn applied_to(&self, camera: &Camera) -> Result<Camera> {
        let [width, height] = self.of(camera);
        let mut camera = camera.fitted_to(width, height);
        if let Some(fov) = self.pinhole_fov()? {
            if camera.is_orthographic() {
                return Err(Error::argument(
                    "--fov",
                    "an orthographic camera has none: change fx and fy in its file",
                ));
            }
            if camera.projection.is_lens() && self.camera_model.is_none() {
                let problem =
                    format!("the cameras are {}: give --camera-model as well", camera.projection.name());
                return Err(Error::argument("--fov", problem));
            }
            let focal = Intrinsics::from_fov_x(fov.to_radians(), width, height).fx;
            camera.fy *= focal / camera.fx;
            camera.fx = focal;
        }
        // Another lens replaces the camera's own.
        if self.camera_model.is_none() {
            camera.check()?;
        }
        self.through_lens(camera)
    }
}
