//! Where pixels are in the world.

use crate::output::expected_depth;
use ashsplat::Frame;
use ashsplat::scene::Camera;
use glam::{Vec3, vec3};

/// Where the pixels of a frame are, in the order of rows, world; None where there is nothing. By the frame's expected depth.
pub fn places(camera: &Camera, frame: &Frame) -> Vec<Option<Vec3>> {
    let world_from_camera = camera.camera_from_world.transpose();
    let place = |(pixel, z): (usize, f32)| {
        let [x, y] = [pixel % frame.width as usize, pixel / frame.width as usize].map(|p| p as f32 + 0.5);
        let ray = vec3((x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, 1.0);
        z.is_finite().then(|| world_from_camera * (z * ray - camera.translation))
    };
    expected_depth(frame).into_iter().enumerate().map(place).collect()
}
