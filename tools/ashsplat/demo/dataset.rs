//! The demo's data set: photographs from two circles, with a sparse, noisy point cloud, as a COLMAP folder, in the
//! layout of the NeRF paper's synthetic scenes, or with a rolling shutter as nerfstudio's `transforms.json`.

use super::lens::Lens;
use ashsplat::scene::{Camera, Intrinsics, PointCloud, WorldFrame};
use ashsplat::{Error, Result};
use ashsplat_demo_scene::city::{self, City};
use ashsplat_demo_scene::{Scene, View, raycast};
use ashsplat_files::colmap::{self, ColmapCamera, ColmapImage};
use ashsplat_files::transforms::opengl_rows;
use ashsplat_files::{Photo, ply};
use ashsplat_program::output;
use ashsplat_program::progress::counting;
use clap::Args;
use glam::{DMat3, DQuat, DVec3, Vec3, vec3};
use image::RgbaImage;
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::json;
use std::f64::consts::TAU;
use std::path::Path;

/// Width of the terrace's photographs, pixels.
const WIDTH: u32 = 256;
/// Horizontal field of view, radians.
const FOV_X: f32 = 0.96;
/// Views on each of the two circles.
const VIEWS_PER_CIRCLE: u32 = 20;
/// Heights of the two circles, as angles above the terrace, radians.
const ELEVATIONS: [f32; 2] = [0.27, 0.72];
const DISTANCE: f32 = 4.0;
/// Target of the cameras: the middle of the group.
const TARGET: Vec3 = vec3(0.0, 0.0, 0.45);
/// Number of points: sparse, like structure from motion.
const POINTS: usize = 6000;
const CITY_POINTS: usize = 12_000;
/// Standard deviation of the points' error, as a share of their distance to the camera: about half a pixel's width
/// across and much more than that along the ray.
const NOISE: f32 = 0.004;
/// One in this many points on the sky is kept, because the sky has few features.
const SKY_SHARE: u32 = 3;

/// How the data set lies on disk.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum Layout {
    /// images/ and sparse/0/, photographs with the sky, points
    #[default]
    Colmap,
    /// transforms_{train,val,test}.json, transparent photographs without the sky, no points
    NerfSynthetic,
}

/// Initial points of the data set.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Points {
    /// Sparse, as from structure from motion; in points3d.ply beside transforms_train.json
    Sparse,
    /// None: training starts from random ones
    None,
}

/// Subject of the photographs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum Subject {
    /// Shapes on a terrace, from all around
    #[default]
    Terrace,
    /// A city of many houses, from above
    City,
}

/// Choices of the data set.
#[derive(Args)]
pub struct Choices {
    /// What is photographed
    #[arg(long, value_enum, default_value_t)]
    scene: Subject,
    /// Lots along a side of the city, 4 to 32: 16 have four times the houses, points and photographs [default: 8]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(4..=32))]
    lots: Option<u32>,
    /// Width of the photographs, 64 to 1024 pixels; their height is three quarters of it [default: 256, for the city 128]
    #[arg(long, value_name = "PIXELS", value_parser = clap::value_parser!(u32).range(64..=1024))]
    photo_width: Option<u32>,
    /// Lens or shutter of the photographs
    #[arg(long, value_enum, default_value_t)]
    lens: Lens,
    /// How the data set lies on disk
    #[arg(long, value_enum, default_value_t)]
    layout: Layout,
    /// Points to start from [default: sparse in COLMAP's layout, none in the other]
    #[arg(long, value_enum, value_name = "KIND")]
    points: Option<Points>,
    /// Leave the sky out in COLMAP's layout too: black, as the other layout's transparent photographs are in training
    #[arg(long)]
    without_sky: bool,
}

impl Choices {
    pub fn check(&self) -> Result<()> {
        if self.lens != Lens::Pinhole && self.layout == Layout::NerfSynthetic {
            let problem = "is not for --layout nerf-synthetic, which has angles of view only";
            return Err(Error::argument("--lens", problem));
        }
        match self.lots.is_some() && self.scene != Subject::City {
            true => Err(Error::argument("--lots", "is of the city: give --scene city as well")),
            false => Ok(()),
        }
    }

    fn city(&self) -> City {
        let usual = City::default();
        City { lots: self.lots.unwrap_or(usual.lots), width: self.photo_width.unwrap_or(usual.width) }
    }

    fn points(&self) -> Points {
        self.points.unwrap_or(match self.layout {
            Layout::Colmap => Points::Sparse,
            Layout::NerfSynthetic => Points::None,
        })
    }
}

/// Photographs the scene and writes it; the same seed gives the same files. With the same points and without the sky,
/// COLMAP's and the synthetic scenes' layouts hold the same cameras, photographs and points, to the bit.
pub fn write(folder: &Path, choices: &Choices, seed: u64, quiet: bool) -> Result<()> {
    let (scene, cameras, count) = match choices.scene {
        Subject::Terrace => (Scene::demo(), cameras(choices.photo_width.unwrap_or(WIDTH)), POINTS),
        Subject::City => {
            let city = choices.city();
            let (lots, usual) = (city.lots as usize, City::default().lots as usize);
            let points = CITY_POINTS * lots * lots / (usual * usual);
            (city::scene(city), city::cameras(city), points)
        }
    };
    let views: Vec<View> = (0..)
        .zip(&cameras)
        .map(|(index, camera)| choices.lens.view(index, camera, DISTANCE.into()))
        .collect();
    let sky = choices.layout == Layout::Colmap && !choices.without_sky;
    let points = match choices.points() {
        Points::Sparse => sparse_points((&scene, &views), count, sky, seed),
        Points::None => PointCloud::default(),
    };
    let bar = counting("photographs", views.len() as u64, quiet);
    let cut_out = |view: &View| {
        bar.inc(1);
        raycast::photograph_cutout(&scene, view)
    };
    let opaque = |view: &View| match sky {
        true => {
            bar.inc(1);
            raycast::photograph(&scene, view)
        }
        false => raycast::on_black(&cut_out(view)),
    };
    match choices.layout {
        Layout::NerfSynthetic => write_nerf_synthetic(folder, &views, &points, cut_out)?,
        Layout::Colmap => {
            let images = write_photographs(folder, &views, opaque)?;
            match choices.lens {
                Lens::RollingShutter => write_rolling(folder, &views, &images, &points)?,
                _ => {
                    let lens = ColmapCamera::of(1, &views[0].camera)?;
                    let images: Vec<ColmapImage> = images.into_iter().map(|pose| pose.image).collect();
                    colmap::write(folder.join("sparse").join("0"), &[lens], &images, &points)?;
                }
            }
        }
    }
    bar.finish_and_clear();
    Ok(())
}

/// File of the points beside a `transforms.json`.
const POINTS_FILE: &str = "points3d.ply";
/// Interval of the held-out views, as in the COLMAP folder.
const TEST_EVERY: u32 = 8;

/// Writes cameras as angles of view and camera-to-world matrices, with the camera's y up and z backward.
fn write_nerf_synthetic(
    folder: &Path,
    views: &[View],
    points: &PointCloud,
    photograph: impl Fn(&View) -> RgbaImage,
) -> Result<()> {
    let (mut train, mut test) = (Vec::new(), Vec::new());
    for (index, view) in (0u32..).zip(views) {
        let (part, frames) =
            if index.is_multiple_of(TEST_EVERY) { ("test", &mut test) } else { ("train", &mut train) };
        let name = format!("{part}/r_{index:03}");
        output::write_rgba_png(&folder.join(format!("{name}.png")), &photograph(view))?;
        let rows = Pose::new(index, String::new(), &view.camera).opengl_rows();
        frames.push(json!({ "file_path": format!("./{name}"), "rotation": 0.0, "transform_matrix": rows }));
    }
    let angle = 2.0 * (0.5 * f64::from(views[0].camera.width) / f64::from(views[0].camera.fx)).atan();
    for (part, frames) in [("train", &train), ("val", &test), ("test", &test)] {
        let document = json!({ "camera_angle_x": angle, "frames": frames });
        output::write_json(&folder.join(format!("transforms_{part}.json")), &document)?;
    }
    write_points(folder, points)
}

/// Writes the points of a `transforms.json`. The reference implementation reads those of synthetic scenes from this file.
fn write_points(folder: &Path, points: &PointCloud) -> Result<()> {
    match points.is_empty() {
        true => Ok(()),
        false => ply::write_points(folder.join(POINTS_FILE), points, &WorldFrame::default()),
    }
}

/// Rotation and position of a camera in double precision. Both layouts are written from it, so that their readers
/// reconstruct the same camera, to the bit.
struct Pose {
    camera_from_world: DMat3,
    eye: DVec3,
    image: ColmapImage,
}

impl Pose {
    fn new(index: u32, name: String, camera: &Camera) -> Pose {
        let mut image = ColmapImage::posed(index + 1, 1, name, camera);
        let [w, x, y, z] = image.quat;
        // Normalised once more, as readers do: matrix elements near 0 depend on the last bits of the quaternion.
        let camera_from_world = DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize());
        let eye = camera.position().as_dvec3();
        image.translation = (-(camera_from_world * eye)).to_array();
        Pose { camera_from_world, eye, image }
    }

    fn opengl_rows(&self) -> [[f64; 4]; 4] {
        opengl_rows(self.camera_from_world, self.eye)
    }
}

/// Writes the photographs, and masks of a lens that does not show all pixels. Returns their poses.
fn write_photographs(
    folder: &Path,
    views: &[View],
    photograph: impl Fn(&View) -> Photo,
) -> Result<Vec<Pose>> {
    // All views have the same lens.
    let mask = raycast::mask(&views[0]);
    let write = |(index, view): (u32, &View)| {
        let name = format!("view_{index:03}.png");
        output::write_png(&folder.join("images").join(&name), &photograph(view))?;
        if let Some(mask) = &mask {
            output::write_png(&folder.join("masks").join(format!("{name}.png")), mask)?;
        }
        Ok(Pose::new(index, name, &view.camera))
    };
    (0..).zip(views).map(write).collect()
}

/// Writes nerfstudio's `transforms.json`, whose pose is that of the first row. It has no keys for a rolling shutter: here,
/// `transform_matrix_end` is the pose at the last row, and `shutter` is the direction in which rows are read.
fn write_rolling(folder: &Path, views: &[View], poses: &[Pose], points: &PointCloud) -> Result<()> {
    let frames = poses.iter().zip(views).map(|(pose, view)| {
        let mut frame = json!({
            "file_path": format!("images/{}", pose.image.name),
            "transform_matrix": pose.opengl_rows(),
        });
        if let Some(last) = &view.last_row {
            frame["transform_matrix_end"] = json!(Pose::new(0, String::new(), last).opengl_rows());
        }
        frame
    });
    let Camera { fx, fy, cx, cy, width, height, .. } = views[0].camera;
    let mut document = json!({
        "camera_model": "PINHOLE", "fl_x": fx, "fl_y": fy, "cx": cx, "cy": cy, "w": width, "h": height,
        "shutter": "down",
        "frames": frames.collect::<Vec<_>>(),
    });
    if !points.is_empty() {
        document["ply_file_path"] = json!(POINTS_FILE);
    }
    output::write_json(&folder.join("transforms.json"), &document)?;
    write_points(folder, points)
}

/// Two circles of cameras, the upper one turned by half a step.
///
/// Every 8th view is held out: three of the lower circle and two of the upper one, none beside another.
fn cameras(width: u32) -> Vec<Camera> {
    let intrinsics = Intrinsics::from_fov_x(FOV_X, width, width * 3 / 4);
    let view = |index: u32| {
        let (circle, place) = (index / VIEWS_PER_CIRCLE, index % VIEWS_PER_CIRCLE);
        let step = std::f32::consts::TAU / VIEWS_PER_CIRCLE as f32;
        let azimuth = (place as f32 + 0.5 * circle as f32) * step;
        let elevation = ELEVATIONS[circle as usize];
        let outward = vec3(azimuth.cos() * elevation.cos(), azimuth.sin() * elevation.cos(), elevation.sin());
        Camera::look_at(TARGET + DISTANCE * outward, TARGET, Vec3::Z, intrinsics)
    };
    (0..VIEWS_PER_CIRCLE * ELEVATIONS.len() as u32).map(view).collect()
}

/// Points on visible surfaces, through random pixels, with an error and the pixel's colour.
fn sparse_points((scene, views): (&Scene, &[View]), count: usize, sky: bool, seed: u64) -> PointCloud {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut points = PointCloud::default();
    while points.len() < count {
        let view = &views[random.random_range(0..views.len())];
        let (width, height) = (view.camera.width, view.camera.height);
        let (x, y) = (random.random_range(0..width), random.random_range(0..height));
        let Some(ray) = view.ray(x as f32 + 0.5, y as f32 + 0.5) else { continue };
        let hit = raycast::first_hit(scene, &ray);
        if hit.is_none() && (!sky || random.random_range(0..SKY_SHARE) != 0) {
            continue;
        }
        let distance = hit.map_or_else(|| ray.sky_distance(), |hit| hit.distance);
        let error = NOISE * distance * vec3(normal(&mut random), normal(&mut random), normal(&mut random));
        points.positions.push((ray.at(distance) + error).to_array());
        points.colors.push(raycast::encode(raycast::pixel_light(scene, view, x, y)));
    }
    points
}

/// A standard normal number (Box and Muller). Double precision hides that each system rounds `ln` and `cos` in its own way.
fn normal(random: &mut impl Rng) -> f32 {
    let [u, v] = [random.random::<f32>(), random.random::<f32>()].map(f64::from);
    ((-2.0 * (1.0 - u).ln()).sqrt() * (TAU * v).cos()) as f32
}
