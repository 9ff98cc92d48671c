//! Positions of pixels in the world.

use crate::output::Depth;
use ashsplat::Frame;
use ashsplat::scene::Camera;
use glam::{Vec3, vec3};

/// Longer side of pictures that only locate things, pixels.
const SIDE: u32 = 200;

/// The camera scaled to at most [`SIDE`].
pub fn small(camera: &Camera) -> Camera {
    let longest = camera.width.max(camera.height);
    let scaled = |side: u32| match longest {
        ..=SIDE => side,
        _ => ((f64::from(side) * f64::from(SIDE) / f64::from(longest)).round() as u32).max(1),
    };
    camera.scaled_to(scaled(camera.width), scaled(camera.height))
}

/// World position of each pixel of a frame, row by row; `None` for transparent pixels. It uses the frame's harmonic
/// depth, which Gaussians far behind a surface hardly move.
pub fn places(camera: &Camera, frame: &Frame) -> Vec<Option<Vec3>> {
    let world_from_camera = camera.camera_from_world.transpose();
    let place = |(pixel, z): (usize, f32)| {
        let [x, y] = [pixel % frame.width as usize, pixel / frame.width as usize].map(|p| p as f32 + 0.5);
        let ray = vec3((x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, 1.0);
        z.is_finite().then(|| world_from_camera * (z * ray - camera.translation))
    };
    Depth::Harmonic.of(frame).into_iter().enumerate().map(place).collect()
}
