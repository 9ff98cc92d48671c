//! The demo's data set: photographs from two circles, with a sparse, noisy point cloud, as a COLMAP folder or in the
//! layout of the NeRF paper's synthetic scenes.

use ashsplat::scene::{Camera, Intrinsics, PointCloud, WorldFrame};
use ashsplat::{Error, Result};
use ashsplat_demo_scene::Scene;
use ashsplat_demo_scene::city::{self, City};
use ashsplat_demo_scene::raycast::{self, Ray};
use ashsplat_files::colmap::{self, ColmapCamera, ColmapImage};
use ashsplat_files::{Photo, ply};
use ashsplat_program::output;
use ashsplat_program::progress::counting;
use clap::Args;
use glam::{DMat3, DQuat, DVec3, Vec3, vec3};
use image::RgbaImage;
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::json;
use std::path::Path;

/// Size of the photographs, pixels.
const SIZE: [u32; 2] = [256, 192];
/// Horizontal field of view, radians.
const FOV_X: f32 = 0.96;
/// Views on each of the two circles.
const VIEWS_PER_CIRCLE: u32 = 20;
/// Heights of the two circles, as angles above the terrace, radians.
const ELEVATIONS: [f32; 2] = [0.27, 0.72];
/// Distance of the cameras to their target.
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

/// Whether the data set has points to start from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Points {
    /// As structure from motion would leave them; points3d.ply beside transforms_train.json
    Sparse,
    /// None: training starts from random ones
    None,
}

/// What is photographed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum Subject {
    /// Shapes on a terrace, from all around
    #[default]
    Terrace,
    /// A city of many houses, from above
    City,
}

/// What of the data set can be chosen.
#[derive(Args)]
pub struct Choices {
    /// What is photographed
    #[arg(long, value_enum, default_value_t)]
    scene: Subject,
    /// Lots along a side of the city, 8 to 32: 16 have four times the houses, points and photographs [default: 8]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(8..=32))]
    lots: Option<u32>,
    /// Width of the city's photographs, 64 to 1024 pixels; their height is three quarters of it [default: 128]
    #[arg(long, value_name = "PIXELS", value_parser = clap::value_parser!(u32).range(64..=1024))]
    photo_width: Option<u32>,
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
    /// Refuses choices that contradict each other.
    pub fn check(&self) -> Result<()> {
        for (name, is_given) in
            [("--lots", self.lots.is_some()), ("--photo-width", self.photo_width.is_some())]
        {
            if is_given && self.scene != Subject::City {
                return Err(Error::argument(name, "is of the city: give --scene city as well"));
            }
        }
        Ok(())
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
/// both layouts hold the same cameras, photographs and points, to the bit.
pub fn write(folder: &Path, choices: &Choices, seed: u64, quiet: bool) -> Result<()> {
    let (scene, cameras, count) = match choices.scene {
        Subject::Terrace => (Scene::demo(), cameras(), POINTS),
        Subject::City => {
            let city = choices.city();
            let (lots, usual) = (city.lots as usize, City::default().lots as usize);
            let points = CITY_POINTS * lots * lots / (usual * usual);
            (city::scene(city), city::cameras(city), points)
        }
    };
    let sky = choices.layout == Layout::Colmap && !choices.without_sky;
    let points = match choices.points() {
        Points::Sparse => sparse_points((&scene, &cameras), count, sky, seed),
        Points::None => PointCloud::default(),
    };
    let bar = counting("photographs", cameras.len() as u64, quiet);
    let cut_out = |camera: &Camera| {
        bar.inc(1);
        raycast::photograph_cutout(&scene, camera)
    };
    let with_sky = |camera: &Camera| {
        bar.inc(1);
        raycast::photograph(&scene, camera)
    };
    match choices.layout {
        Layout::Colmap if sky => write_colmap(folder, &cameras, &points, with_sky)?,
        Layout::Colmap => {
            write_colmap(folder, &cameras, &points, |camera| raycast::on_black(&cut_out(camera)))?;
        }
        Layout::NerfSynthetic => write_nerf_synthetic(folder, &cameras, &points, cut_out)?,
    }
    bar.finish_and_clear();
    Ok(())
}

/// Interval of the held-out views, as in the COLMAP folder.
const TEST_EVERY: u32 = 8;

/// Writes cameras as angles of view and camera-to-world matrices, with the camera's y up and z backward.
fn write_nerf_synthetic(
    folder: &Path,
    cameras: &[Camera],
    points: &PointCloud,
    photograph: impl Fn(&Camera) -> RgbaImage,
) -> Result<()> {
    let (mut train, mut test) = (Vec::new(), Vec::new());
    for (index, camera) in (0u32..).zip(cameras) {
        let (part, frames) =
            if index.is_multiple_of(TEST_EVERY) { ("test", &mut test) } else { ("train", &mut train) };
        let name = format!("{part}/r_{index:03}");
        output::write_rgba_png(&folder.join(format!("{name}.png")), &photograph(camera))?;
        let rows = Pose::new(index, String::new(), camera).opengl_rows();
        frames.push(json!({ "file_path": format!("./{name}"), "rotation": 0.0, "transform_matrix": rows }));
    }
    let angle = 2.0 * (0.5 * f64::from(cameras[0].width) / f64::from(cameras[0].fx)).atan();
    for (part, frames) in [("train", &train), ("val", &test), ("test", &test)] {
        let document = json!({ "camera_angle_x": angle, "frames": frames });
        output::write_json(&folder.join(format!("transforms_{part}.json")), &document)?;
    }
    if points.is_empty() {
        return Ok(());
    }
    // The reference implementation reads the points of such scenes from this file.
    ply::write_points(folder.join("points3d.ply"), points, &WorldFrame::default())
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

    /// Rows of the matrix from the camera (y up, z backward) to the world.
    fn opengl_rows(&self) -> Vec<[f64; 4]> {
        let axes = self.camera_from_world.transpose();
        let rows = (0..3).map(|r| [axes.x_axis[r], -axes.y_axis[r], -axes.z_axis[r], self.eye[r]]);
        rows.chain([[0.0, 0.0, 0.0, 1.0]]).collect()
    }
}

fn write_colmap(
    folder: &Path,
    cameras: &[Camera],
    points: &PointCloud,
    photograph: impl Fn(&Camera) -> Photo,
) -> Result<()> {
    let mut images = Vec::with_capacity(cameras.len());
    for (index, camera) in (0..).zip(cameras) {
        let name = format!("view_{index:03}.png");
        output::write_png(&folder.join("images").join(&name), &photograph(camera))?;
        images.push(Pose::new(index, name, camera).image);
    }
    let lens = ColmapCamera::pinhole(1, &cameras[0]);
    colmap::write(folder.join("sparse").join("0"), &[lens], &images, points)
}

/// Two circles of cameras, the upper one turned by half a step.
///
/// Every 8th view is held out: three of the lower circle and two of the upper one, none beside another.
fn cameras() -> Vec<Camera> {
    let intrinsics = Intrinsics::from_fov_x(FOV_X, SIZE[0], SIZE[1]);
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
fn sparse_points((scene, cameras): (&Scene, &[Camera]), count: usize, sky: bool, seed: u64) -> PointCloud {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut points = PointCloud::default();
    while points.len() < count {
        let camera = &cameras[random.random_range(0..cameras.len())];
        let (x, y) = (random.random_range(0..camera.width), random.random_range(0..camera.height));
        let ray = Ray::through_pixel(camera, x as f32 + 0.5, y as f32 + 0.5);
        let hit = raycast::first_hit(scene, &ray);
        if hit.is_none() && (!sky || random.random_range(0..SKY_SHARE) != 0) {
            continue;
        }
        let distance = hit.map_or_else(|| ray.sky_distance(), |hit| hit.distance);
        let error = NOISE * distance * vec3(normal(&mut random), normal(&mut random), normal(&mut random));
        points.positions.push((ray.at(distance) + error).to_array());
        points.colors.push(raycast::encode(raycast::pixel_light(scene, camera, x, y)));
    }
    points
}

/// A standard normal number (Box and Muller).
fn normal(random: &mut impl Rng) -> f32 {
    let radius = (-2.0 * (1.0 - random.random::<f32>()).ln()).sqrt();
    radius * (std::f32::consts::TAU * random.random::<f32>()).cos()
}
