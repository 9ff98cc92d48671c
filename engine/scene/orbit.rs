//! A circle of cameras around a point.

use glam::{DMat3, DVec3, Vec3};

use super::camera::{Camera, Intrinsics};
use super::strays::without_strays;

/// Steps of the iteration for the vertical. Each gains at least three digits unless axes are nearly parallel.
const INVERSE_ITERATIONS: u32 = 8;

/// A circular camera path that looks at its centre.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Orbit {
    /// Point that all cameras look at, world units.
    pub center: Vec3,
    /// World direction that is up in the pictures, of any length.
    pub up: Vec3,
    /// Distance of the cameras to the centre, world units.
    pub radius: f32,
    /// Angle above the plane through the centre, radians.
    pub elevation: f32,
    /// Number of cameras in one full turn.
    pub count: u32,
    /// Focal length and size of every camera.
    pub intrinsics: Intrinsics,
}

impl Orbit {
    /// Returns the cameras in order; the last is one step before the first.
    pub fn cameras(&self) -> Vec<Camera> {
        let up = self.up.as_dvec3().try_normalize().unwrap_or(DVec3::NEG_Y);
        let side = up.any_orthonormal_vector();
        let front = up.cross(side);
        let (center, elevation) = (self.center.as_dvec3(), f64::from(self.elevation));
        (0..self.count)
            .map(|i| {
                let azimuth = std::f64::consts::TAU * f64::from(i) / f64::from(self.count);
                let outward = side * libm::cos(azimuth) + front * libm::sin(azimuth);
                let direction = outward * libm::cos(elevation) + up * libm::sin(elevation);
                let eye = center + direction * f64::from(self.radius);
                Camera::look_from(eye, center, up, self.intrinsics)
            })
            .collect()
    }

    /// Creates an orbit that resembles existing cameras. It has their mean distance to the point they look at, and their mean
    /// height above it; up is the direction across their horizontal axes. None without cameras. Excludes
    /// [`strays`](super::strays()).
    ///
    /// The centre is the point nearest to all optical axes (least squares). For parallel axes it is one world unit ahead of the
    /// cameras, see [`Orbit::around_scene`].
    pub fn around(cameras: &[Camera], count: u32, intrinsics: Intrinsics) -> Option<Self> {
        Self::around_scene(cameras, None, count, intrinsics)
    }

    /// Same as [`Orbit::around`], but around `scene_center` (world units) if the cameras' axes are parallel and it lies in
    /// front of them.
    pub fn around_scene(
        cameras: &[Camera],
        scene_center: Option<Vec3>,
        count: u32,
        intrinsics: Intrinsics,
    ) -> Option<Self> {
        let cameras = &without_strays(cameras, Camera::position)[..];
        if cameras.is_empty() {
            return None;
        }
        let n = cameras.len() as f32;
        let mean = |f: &dyn Fn(&Camera) -> Vec3| cameras.iter().map(f).sum::<Vec3>() / n;
        let up = level_up(cameras).map_or(Vec3::NEG_Y, |up| up.as_vec3());
        let middle = mean(&|c| c.position());
        let forward = mean(&|c| c.forward());
        let center = nearest_to_axes(cameras, PARALLEL)
            .or_else(|| scene_center.filter(|center| (*center - middle).dot(forward) > 0.0))
            .unwrap_or(middle + forward);
        let radius = cameras.iter().map(|c| c.position().distance(center)).sum::<f32>() / n;
        let height = (middle - center).dot(up);
        let elevation = if radius > 0.0 { libm::asinf((height / radius).clamp(-1.0, 1.0)) } else { 0.0 };
        Some(Self { center, up, radius, elevation, count, intrinsics })
    }
}

/// Direction across the cameras' horizontal axes; `None` if the pictures' up directions cancel out. The mean of the pictures' up
/// directions would lean, because cameras above a scene look down.
pub fn level_up(cameras: &[Camera]) -> Option<DVec3> {
    let mean: Vec3 = cameras.iter().map(|c| -c.camera_from_world.row(1)).sum();
    let across = cameras.iter().fold(DMat3::ZERO, |sum, camera| {
        let right = camera.camera_from_world.row(0).as_dvec3();
        sum + DMat3::from_cols(right * right.x, right * right.y, right * right.z)
    });
    // Inverse iteration to the eigenvector of the smallest eigenvalue. For parallel axes it stays close to the mean.
    let inverse =
        (across * (1.0 / cameras.len() as f64) + DMat3::from_diagonal(DVec3::splat(1e-4))).inverse();
    (0..INVERSE_ITERATIONS).try_fold(mean.as_dvec3().try_normalize()?, |up, _| (inverse * up).try_normalize())
}

/// Mean sin² between axes below which they determine no depth.
pub(super) const PARALLEL: f64 = 1e-4;

/// Point with the least sum of squared distances to the cameras' optical axes. None if these are parallel: the determinant of
/// their mean projection, which falls to 0 then, is at most `min_determinant`.
pub fn nearest_to_axes(cameras: &[Camera], min_determinant: f64) -> Option<Vec3> {
    let (mut a, mut b) = (DMat3::ZERO, DVec3::ZERO);
    for camera in cameras {
        let d = camera.forward().as_dvec3();
        let across = DMat3::IDENTITY - DMat3::from_cols(d * d.x, d * d.y, d * d.z);
        a += across;
        b += across * camera.position().as_dvec3();
    }
    let scaled = a * (1.0 / cameras.len() as f64);
    (scaled.determinant() > min_determinant).then(|| (a.inverse() * b).as_vec3()).filter(|p| p.is_finite())
}
