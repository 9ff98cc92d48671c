//! The program `ashsplat`, run as users run it.

mod archives;
mod bad_input;
mod blocks;
mod checkpoints;
mod commands;
mod convert;
mod divisions;
mod exchange;
mod few_photos;
mod filters;
mod init;
mod inspect;
mod layouts;
mod light;
#[cfg(unix)]
mod lock;
mod lpips;
mod merge;
mod moved;
mod pose_opt;
// The stand-ins are shell scripts.
#[cfg(unix)]
mod poses;
mod report;
mod run;
mod strategies;
mod tiles;
mod training;
mod unused;

use ashsplat::scene::{Camera, Intrinsics, PointCloud};
use ashsplat_files::colmap::{self, ColmapCamera, ColmapImage};
use ashsplat_files::{Photo, PhotoFileFormat};
use glam::{Vec3, vec3};
use std::path::{Path, PathBuf};
use std::process::Command;

pub(crate) use run::{Finished, finish, program, text};

/// Size of the photos of [`write_dataset`], pixels.
const SIZE: [u32; 2] = [48, 32];
/// Number of views of [`write_dataset`]; with `--eval` the first and the last are held out.
const VIEWS: u32 = 9;

/// Runs the program, which must succeed. Returns its stdout.
pub(crate) fn succeed(arguments: &[&str]) -> String {
    let run = finish(program().args(arguments));
    assert_eq!(run.code, Some(0), "{arguments:?}: {}", run.stderr);
    run.stdout
}

/// Checks that the program refused: exit code 2, nothing on stdout, one line `error: …` with all of these words.
pub(crate) fn assert_refused(run: &Finished, words: &[&str]) {
    assert_eq!(run.code, Some(2), "{}{}", run.stdout, run.stderr);
    let errors: Vec<&str> = run.stderr.lines().filter(|line| !line.starts_with("warning: ")).collect();
    assert_eq!(errors.len(), 1, "{}", run.stderr);
    assert!(errors[0].starts_with("error: "), "{}", run.stderr);
    for word in words {
        assert!(errors[0].contains(word), "no '{word}' in: {}", errors[0]);
    }
}

/// Runs the program, which must refuse.
pub(crate) fn refuse(arguments: &[&str], words: &[&str]) {
    assert_refused(&finish(program().args(arguments)), words);
}

/// All files below a folder, sorted, with relative paths.
fn files_below(folder: &Path) -> Vec<PathBuf> {
    let mut files = Vec::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(next) = folders.pop() {
        let Ok(entries) = std::fs::read_dir(&next) else { continue };
        for entry in entries {
            let path = entry.expect("a folder's entry").path();
            if path.is_dir() {
                folders.push(path);
            } else {
                files.push(path.strip_prefix(folder).expect("below the folder").to_owned());
            }
        }
    }
    files.sort();
    files
}

/// Writes a COLMAP data set of a coloured wall, photographed from nine positions; a formula gives every pixel.
pub(crate) fn write_dataset(folder: &Path) {
    let views: Vec<Camera> = (0..VIEWS).map(view).collect();
    let mut images = Vec::new();
    std::fs::create_dir_all(folder.join("images")).expect("a folder for the photos");
    for (id, camera) in (1..).zip(&views) {
        let name = format!("{id:02}.png");
        photograph(camera).write_png(folder.join("images").join(&name)).expect("a photo");
        images.push(ColmapImage::posed(id, 1, name, camera));
    }
    write_model(folder, &images, &wall_points());
}

/// Writes the model of [`write_dataset`] with these images and points.
fn write_model(folder: &Path, images: &[ColmapImage], points: &PointCloud) {
    let lens = ColmapCamera::pinhole(1, &view(0));
    colmap::write(folder.join("sparse/0"), &[lens], images, points).expect("a COLMAP model");
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
