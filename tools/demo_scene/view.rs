//! Cameras that photograph a scene: pinholes, lenses and rolling shutters.

use crate::scene::SKY_RADIUS;
use ashsplat::scene::Camera;
use glam::{DMat3, DQuat, DVec2, DVec3, Vec3, dvec2, vec3};
use std::f64::consts::PI;

/// A camera that photographs a scene.
pub struct View {
    /// The camera; with a rolling shutter, its pose at the first row.
    pub camera: Camera,
    /// The camera at the last row of a rolling shutter.
    pub last_row: Option<Camera>,
    /// Largest angle from the axis that the lens shows, radians. Photographs are black beyond it.
    rim: f64,
    /// The inverse of the lens; None for a pinhole.
    directions: Option<Box<dyn Fn(DVec2) -> Option<DVec3> + Send + Sync>>,
}

impl View {
    /// The view of a camera without a rim, whose rows are exposed at the same time.
    pub fn new(camera: Camera) -> View {
        let directions = camera.projection.is_lens().then(|| Box::new(camera.photo_lens().rays()) as _);
        View { camera, last_row: None, rim: PI, directions }
    }

    /// The view through a lens that shows directions up to an angle from its axis, radians.
    pub fn with_rim(self, rim: f64) -> View {
        View { rim, ..self }
    }

    /// The view of a rolling shutter, which moves to another camera while its rows are read from the first to the last.
    pub fn moving_to(self, last_row: Camera) -> View {
        View { last_row: Some(last_row), ..self }
    }

    /// The ray through a point of the image; pixels, the centre of the first pixel at (0.5, 0.5). None where the lens shows
    /// nothing.
    pub fn ray(&self, x: f32, y: f32) -> Option<Ray> {
        let camera = self.at_row(y);
        let in_camera = match &self.directions {
            None => vec3((x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, 1.0),
            Some(direction) => {
                let shown = direction(dvec2(x.into(), y.into()))?;
                (shown.angle_between(DVec3::Z) <= self.rim).then_some(shown.as_vec3())?
            }
        };
        let direction = (camera.camera_from_world.transpose() * in_camera).normalize();
        Some(Ray { origin: camera.position(), direction })
    }

    /// The camera while it reads a row. Its centre moves along a line, and it turns about one axis.
    fn at_row(&self, y: f32) -> Camera {
        let Some(last) = &self.last_row else { return self.camera };
        let first = &self.camera;
        let share = ((f64::from(y) - 0.5) / (f64::from(first.height) - 1.0)).clamp(0.0, 1.0);
        let [from, to] = [first, last].map(|camera| DQuat::from_mat3(&camera.camera_from_world.as_dmat3()));
        let turn = DQuat::from_scaled_axis(share * (to * from.inverse()).to_scaled_axis());
        let center = first.exact_position().lerp(last.exact_position(), share);
        Camera::at(center, DMat3::from_quat(turn * from), first.intrinsics())
    }
}

/// A ray in world coordinates; the direction is of unit length.
#[derive(Clone, Copy)]
pub struct Ray {
    pub(crate) origin: Vec3,
    pub(crate) direction: Vec3,
}

impl Ray {
    /// The point at a distance.
    pub fn at(&self, distance: f32) -> Vec3 {
        self.origin + self.direction * distance
    }

    /// Distance to the sky's dome, which is larger for rays that start far out.
    pub fn sky_distance(&self) -> f32 {
        let b = self.origin.dot(self.direction);
        let radius = SKY_RADIUS.max(1.5 * self.origin.length());
        -b + (b * b - self.origin.length_squared() + radius * radius).max(0.0).sqrt()
    }
}
