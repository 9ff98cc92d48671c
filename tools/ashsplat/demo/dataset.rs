//! The demo's data set: photographs from two circles, with a sparse, noisy point cloud as a COLMAP folder, or as the
//! synthetic scenes of the NeRF paper lie.

use super::raycast::{self, Ray};
use super::scene::Scene;
use crate::output;
use crate::progress::counting;
use ashsplat::Result;
use ashsplat::io::colmap::{self, ColmapCamera, ColmapImage};
use ashsplat::scene::{Camera, Intrinsics, PointCloud};
use glam::{Vec3, vec3};
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
/// Distance of the cameras to what they look at.
const DISTANCE: f32 = 4.0;
/// What they look at: the middle of the group.
const TARGET: Vec3 = vec3(0.0, 0.0, 0.45);
/// Size of the point cloud: sparse, as structure from motion would leave it.
const POINTS: usize = 6000;
/// Standard deviation of the points' error, as a share of their distance to the camera: about half a pixel's width
/// across and much more than that along the ray.
const NOISE: f32 = 0.004;
/// Of the points that would lie on the sky, one in so many is kept: it has few features.
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

/// Photographs the scene and writes it; the same files for the same seed.
pub fn write(folder: &Path, layout: Layout, seed: u64, quiet: bool) -> Result<()> {
    match layout {
        Layout::Colmap => write_colmap(folder, seed, quiet),
        Layout::NerfSynthetic => write_nerf_synthetic(folder, quiet),
    }
}

/// Every so manieth view is held out, as it would be in the COLMAP folder.
const TEST_EVERY: usize = 8;

/// Cameras by the angle that they see and by matrices from camera to world, the camera's y up and z backward.
fn write_nerf_synthetic(folder: &Path, quiet: bool) -> Result<()> {
    let scene = Scene::demo();
    let cameras = cameras();
    let bar = counting("photographs", cameras.len() as u64, quiet);
    let (mut train, mut test) = (Vec::new(), Vec::new());
    for (index, camera) in cameras.iter().enumerate() {
        let (part, frames) =
            if index.is_multiple_of(TEST_EVERY) { ("test", &mut test) } else { ("train", &mut train) };
        let name = format!("{part}/r_{index:03}");
        let photo = raycast::photograph_cutout(&scene, camera);
        output::write_rgba_png(&folder.join(format!("{name}.png")), &photo)?;
        let axes = camera.camera_from_world.transpose();
        let eye = camera.position();
        let rows: Vec<[f32; 4]> = (0..3)
            .map(|r| [axes.x_axis[r], -axes.y_axis[r], -axes.z_axis[r], eye[r]])
            .chain([[0.0, 0.0, 0.0, 1.0]])
            .collect();
        frames.push(json!({ "file_path": format!("./{name}"), "rotation": 0.0, "transform_matrix": rows }));
        bar.inc(1);
    }
    bar.finish_and_clear();
    for (part, frames) in [("train", &train), ("val", &test), ("test", &test)] {
        let document = json!({ "camera_angle_x": FOV_X, "frames": frames });
        output::write_json(&folder.join(format!("transforms_{part}.json")), &document)?;
    }
    Ok(())
}

fn write_colmap(folder: &Path, seed: u64, quiet: bool) -> Result<()> {
    let scene = Scene::demo();
    let cameras = cameras();
    let bar = counting("photographs", cameras.len() as u64, quiet);
    let mut images = Vec::with_capacity(cameras.len());
    for (index, camera) in (0..).zip(&cameras) {
        let name = format!("view_{index:03}.png");
        let photo = raycast::photograph(&scene, camera);
        output::write_png(&folder.join("images").join(&name), &photo)?;
        images.push(ColmapImage::posed(index + 1, 1, name, camera));
        bar.inc(1);
    }
    bar.finish_and_clear();
    let points = sparse_points(&scene, &cameras, seed);
    let lens = ColmapCamera::pinhole(1, &cameras[0]);
    colmap::write(folder.join("sparse").join("0"), &[lens], &images, &points)
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

/// Points on surfaces that the cameras see, through random pixels, with an error and the pixel's colour.
fn sparse_points(scene: &Scene, cameras: &[Camera], seed: u64) -> PointCloud {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut points = PointCloud::default();
    while points.len() < POINTS {
        let camera = &cameras[random.random_range(0..cameras.len())];
        let (x, y) = (random.random_range(0..camera.width), random.random_range(0..camera.height));
        let ray = Ray::through_pixel(camera, x as f32 + 0.5, y as f32 + 0.5);
        let hit = raycast::first_hit(scene, &ray);
        if hit.is_none() && random.random_range(0..SKY_SHARE) != 0 {
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
