//! A data set of lenses with distortion.

// In a test, an unwrap is an assertion.
#![allow(clippy::unwrap_used)]

use ashsplat::scene::{Camera, Intrinsics, PointCloud};
use ashsplat_files::colmap::{self, CameraModel, ColmapCamera, ColmapImage};
use ashsplat_files::{Photo, PhotoFileFormat};
use glam::Vec3;
use std::path::Path;

/// Each of COLMAP's models with parameters of a wide consumer lens, for photos of 320×240.
pub fn cameras() -> Vec<ColmapCamera> {
    let camera = |(id, (name, parameters)): (u32, (&str, Vec<f64>))| ColmapCamera {
        id,
        model: CameraModel::from_name(name).unwrap(),
        width: 320,
        height: 240,
        parameters,
    };
    let models = vec![
        ("SIMPLE_RADIAL", vec![250.0, 160.0, 120.0, -0.12]),
        ("SIMPLE_RADIAL", vec![260.0, 158.0, 123.0, 0.09]),
        ("RADIAL", vec![250.0, 161.0, 118.0, -0.2, 0.05]),
        ("OPENCV", vec![255.0, 245.0, 163.0, 119.0, -0.15, 0.03, 0.002, -0.001]),
        ("OPENCV_FISHEYE", vec![200.0, 201.0, 159.0, 121.0, -0.02, 0.01, -0.003, 0.0005]),
        ("FULL_OPENCV", vec![255.0, 245.0, 160.0, 120.0, 0.1, 0.02, 0.001, -0.001, 0.003, 0.2, 0.03, 0.001]),
    ];
    (1..).zip(models).map(camera).collect()
}

fn picture(width: u32, height: u32) -> Photo {
    let pixel = |index: u32| {
        let (x, y) = ((index % width) as f32, (index / width) as f32);
        let wave = |phase: f32| (127.5 + 110.0 * phase.sin()) as u8;
        [wave(0.05 * x + 0.02 * y), wave(0.04 * y - 0.01 * x + 1.0), wave(0.001 * x * y)]
    };
    Photo { width, height, rgb: (0..width * height).flat_map(pixel).collect() }
}

/// Writes a data set with one photo per camera, all from the same pose.
pub fn write(folder: &Path) {
    std::fs::create_dir_all(folder.join("images")).unwrap();
    let cameras = cameras();
    let pose = Camera::look_at(
        Vec3::new(0.0, 0.0, -3.0),
        Vec3::ZERO,
        Vec3::NEG_Y,
        Intrinsics::from_fov_x(1.0, 320, 240),
    );
    let mut images = Vec::new();
    for camera in &cameras {
        let name = format!("{}.png", camera.id);
        picture(320, 240).write_png(folder.join("images").join(&name)).unwrap();
        let shifted = Camera { translation: pose.translation + Vec3::X * camera.id as f32, ..pose };
        images.push(ColmapImage::posed(camera.id, camera.id, name, &shifted));
    }
    let points = PointCloud { positions: vec![[0.0; 3]; 2], colors: vec![[9; 3]; 2] };
    colmap::write(folder.join("sparse/0"), &cameras, &images, &points).unwrap();
}
