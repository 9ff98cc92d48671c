//! A pinhole camera.

use glam::{Mat3, Vec3};

/// A pinhole camera in COLMAP's and OpenCV's frame: x right, y down, z forward.
///
/// `x_camera = camera_from_world * x_world + translation`; a point projects to
/// `(fx·x/z + cx, fy·y/z + cy)` pixels, where the centre of the first pixel is (0.5, 0.5).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// Rotation from world to camera axes.
    pub camera_from_world: Mat3,
    /// Translation from world to camera, world units.
    pub translation: Vec3,
    /// Focal length in x, pixels.
    pub fx: f32,
    /// Focal length in y, pixels.
    pub fy: f32,
    /// Principal point in x, pixels (centre of the first pixel at 0.5).
    pub cx: f32,
    /// Principal point in y, pixels (centre of the first pixel at 0.5).
    pub cy: f32,
    /// Width of the image, pixels.
    pub width: u32,
    /// Height of the image, pixels.
    pub height: u32,
}

impl Camera {
    /// The camera's centre in world coordinates: `-Rᵀ t`.
    pub fn position(&self) -> Vec3 {
        -(self.camera_from_world.transpose() * self.translation)
    }
}
