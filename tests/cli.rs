//! The program `ashsplat`, run as users run it.

mod appearance;
mod bad_input;
mod blocks;
mod checkpoints;
mod commands;
mod convert;
mod data_sets;
mod exchange;
mod filters;
mod inspect;
mod lpips;
mod merge;
mod mesh;
mod moved;
mod place;
mod pose_opt;
#[cfg(unix)]
mod poses;
mod run;
mod settings;
mod tiles;
mod training;

use crate::common::{assert_says, with_slashes};
use crate::program::running::Running;
use ashsplat::scene::{Camera, Gaussians, Intrinsics, PointCloud, WorldFrame};
use ashsplat::train::Checkpoint;
use ashsplat_files::colmap::{ColmapCamera, ColmapImage};
use ashsplat_files::splats::{ReadOptions, WriteOptions};
use ashsplat_files::{CheckpointFile, Photo, PhotoFileFormat, colmap, splats};
use glam::{Vec3, vec3};
pub(crate) use place::{TestFolder, point_cloud, wait_until};
pub(crate) use run::{Finished, assert_refused, finish, program, text};
use serde_json::Value;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// Size of the photos of [`write_dataset`], pixels.
const SIZE: [u32; 2] = [48, 32];
/// Number of views of [`write_dataset`]; with `--eval` the first and the last are held out.
const VIEWS: u32 = 9;

/// Runs the program, which must succeed. Returns its stdout.
#[track_caller]
pub(crate) fn succeed(arguments: &[&str]) -> String {
    finish(program().args(arguments)).ok().stdout
}

#[track_caller]
pub(crate) fn refuse(arguments: &[&str], words: &[&str]) {
    finish(program().args(arguments)).refused(words);
}

/// Writes a COLMAP data set of a coloured wall, photographed from nine positions; a formula gives every pixel.
pub(crate) fn write_dataset(folder: &Path) {
    std::fs::create_dir_all(folder.join("images")).expect("a folder for the photos");
    for id in 1..=VIEWS {
        let photo = folder.join(format!("images/{id:02}.png"));
        photograph(&view(id - 1)).write_png(photo).expect("a photo");
    }
    write_model(folder, &images(), &wall_points());
}

/// Writes the model of [`write_dataset`] with these images and points.
fn write_model(folder: &Path, images: &[ColmapImage], points: &PointCloud) {
    let lens = ColmapCamera::pinhole(1, &view(0));
    colmap::write(folder.join("sparse/0"), &[lens], images, points).expect("a COLMAP model");
}

/// Replaces the model of [`write_dataset`] by text files.
fn write_text_model(folder: &Path, images: &str, points: &str) {
    let Camera { fx, fy, cx, cy, width, height, .. } = view(0);
    let cameras = format!("1 PINHOLE {width} {height} {fx} {fy} {cx} {cy}\n");
    for (part, text) in [("cameras", cameras.as_str()), ("images", images), ("points3D", points)] {
        let file = folder.join("sparse/0").join(part);
        std::fs::remove_file(file.with_extension("bin")).expect("removed");
        std::fs::write(file.with_extension("txt"), text).expect("written");
    }
}

/// Writes the data set of [`write_dataset`], with observations of the points in the photos.
fn write_observed(folder: &Path) {
    write_dataset(folder);
    let (points, mut images, mut rows) = (wall_points(), String::new(), String::new());
    for image in self::images() {
        let ([w, x, y, z], [tx, ty, tz]) = (image.quat, image.translation);
        images += &format!("{} {w} {x} {y} {z} {tx} {ty} {tz} 1 {}\n", image.id, image.name);
        for (id, position) in (1..).zip(&points.positions) {
            let (x, y, _) = view(image.id - 1).project(Vec3::from_array(*position));
            images += &format!("{x} {y} {id} ");
        }
        images += "3 3 -1\n";
    }
    for (id, ([x, y, z], [r, g, b])) in (1..).zip(points.positions.iter().zip(&points.colors)) {
        rows += &format!("{id} {x} {y} {z} {r} {g} {b} 0.5 1 2\n");
    }
    write_text_model(folder, &images, &rows);
}

fn photo_name(index: u32) -> String {
    format!("{:02}.png", index + 1)
}

fn images() -> Vec<ColmapImage> {
    (0..VIEWS).map(|index| ColmapImage::posed(index + 1, 1, photo_name(index), &view(index))).collect()
}

fn view(index: u32) -> Camera {
    let across = index as f32 / (VIEWS - 1) as f32 - 0.5;
    let eye = vec3(across, 0.2 * (index % 3) as f32, -2.5);
    Camera::look_at(eye, Vec3::ZERO, Vec3::NEG_Y, Intrinsics::from_fov_x(0.8, SIZE[0], SIZE[1]))
}

/// A camera's photograph of the wall at z = 0.
fn photograph(camera: &Camera) -> Photo {
    let mut rgb = Vec::new();
    let world_from_camera = camera.camera_from_world.transpose();
    for (y, x) in (0..camera.height).flat_map(|y| (0..camera.width).map(move |x| (y, x))) {
        let (x, y) = (x as f32 + 0.5 - camera.cx, y as f32 + 0.5 - camera.cy);
        let ray = world_from_camera * vec3(x / camera.fx, y / camera.fy, 1.0);
        let eye = camera.position();
        rgb.extend(wall_color(eye - ray * (eye.z / ray.z)));
    }
    Photo { width: camera.width, height: camera.height, rgb }
}

fn wall_color(point: Vec3) -> [u8; 3] {
    let wave = |phase: f32| (127.5 + 120.0 * phase.sin()) as u8;
    [wave(5.0 * point.x), wave(4.0 * point.y + 1.0), wave(3.0 * (point.x + point.y))]
}

fn wall_points() -> PointCloud {
    let place = |index: u32| vec3((index % 20) as f32 / 9.5 - 1.0, (index / 20) as f32 / 9.5 - 1.0, 0.0);
    let places: Vec<Vec3> = (0..400).map(place).collect();
    PointCloud {
        positions: places.iter().map(|p| p.to_array()).collect(),
        colors: places.iter().map(|&p| wall_color(p)).collect(),
    }
}

/// Gaussians at the wall's points, as training begins with them.
fn wall(sh_degree: u32) -> Gaussians {
    ashsplat_files::initial_gaussians(&wall_points(), sh_degree).expect("Gaussians")
}

/// The transforms.json of square photos from a row of places.
pub(crate) fn transforms(names: &[String], side: u32) -> String {
    let frame = |(index, name): (usize, &String)| {
        let x = 0.1 * index as f64;
        let rows = [[1.0, 0.0, 0.0, x], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 4.0], [0.0, 0.0, 0.0, 1.0]];
        serde_json::json!({ "file_path": name, "transform_matrix": rows })
    };
    let frames: Vec<Value> = names.iter().enumerate().map(frame).collect();
    serde_json::json!({ "fl_x": side, "fl_y": side, "w": side, "h": side, "frames": frames }).to_string()
}
