//! The moving camera: the same as `web/camera.js` on the page. Axes are the engine's: x right, y down, z forward.

use ashsplat::scene::{Camera, Intrinsics, Projection};
use glam::{DVec3, Mat3};

/// Smallest angle between view and pole, radians.
const POLE: f64 = 0.02;
/// Least distance to the pivot, world units; also a share of the scene's size.
const NEAREST: f64 = 1e-4;
const NEAREST_SHARE: f64 = 1e-3;
/// Widest angle of view that is taken over from a lens, radians.
const WIDEST: f64 = 1.4;

/// Camera pose, and the pivot that it turns around.
#[derive(Clone, Copy, Debug)]
pub struct Navigation {
    pub position: DVec3,
    /// Rows: right, down, forward.
    rotation: [DVec3; 3],
    /// Vertical field of view, radians.
    fov_y: f64,
    pub pivot: DVec3,
    pub up: DVec3,
    /// Length of a stride, world units.
    pub radius: f64,
    /// A photo's camera, while the view is exactly the photo's.
    pub lens: Option<Camera>,
}

impl Navigation {
    pub fn new(pivot: DVec3, up: DVec3, radius: f64) -> Self {
        let rotation = [DVec3::X, DVec3::Y, DVec3::Z];
        let radius = if radius > 0.0 { radius } else { 1.0 };
        let position = pivot - radius * DVec3::Z;
        Self { position, rotation, fov_y: 0.9, pivot, up, radius, lens: None }
    }

    fn forward(&self) -> DVec3 {
        self.rotation[2]
    }

    fn distance(&self) -> f64 {
        (self.pivot - self.position).length().max(NEAREST)
    }

    pub fn is_photo(&self) -> bool {
        self.lens.is_some()
    }

    /// Marks the view as no photo's any more.
    pub fn touch(&mut self) {
        self.lens = None;
        self.rotation = orthonormal(self.rotation);
    }

    /// Takes a camera's pose. With `photo`, its lens is kept until the view changes.
    pub fn take(&mut self, camera: &Camera, photo: bool) {
        let rows = camera.camera_from_world.transpose();
        self.rotation = [rows.x_axis, rows.y_axis, rows.z_axis].map(|row| row.as_dvec3());
        self.position = -self.to_world(camera.translation.as_dvec3());
        self.fov_y = 2.0 * (0.5 * f64::from(camera.height) / f64::from(camera.fy)).atan();
        if camera.projection.is_lens() {
            // Fisheyes and panoramas show more than a pinhole should.
            self.fov_y = self.fov_y.min(WIDEST);
        }
        // Turning continues around the axis' nearest point to the old pivot.
        let ahead = (self.pivot - self.position).dot(self.forward());
        let ahead = if ahead > 0.05 * self.radius { ahead } else { self.radius };
        self.pivot = self.position + self.forward() * ahead;
        // A panorama cannot lie within a picture of another shape.
        self.lens = Some(*camera).filter(|_| photo && camera.projection != Projection::Equirectangular);
    }

    fn to_world(self, v: DVec3) -> DVec3 {
        self.rotation[0] * v.x + self.rotation[1] * v.y + self.rotation[2] * v.z
    }

    /// Turns around the pivot: `yaw` about up, `pitch` about the camera's right, radians.
    pub fn orbit(&mut self, yaw: f64, pitch: f64) {
        self.turn_about(self.pivot, yaw, pitch);
    }

    /// Turns around the camera's own position.
    pub fn look(&mut self, yaw: f64, pitch: f64) {
        let distance = self.distance();
        self.turn_about(self.position, yaw, pitch);
        self.pivot = self.position + self.forward() * distance;
    }

    fn turn_about(&mut self, center: DVec3, yaw: f64, pitch: f64) {
        let above = self.forward().dot(self.up).clamp(-1.0, 1.0).acos();
        let (low, high) = (POLE - (std::f64::consts::PI - above), above - POLE);
        let pitch = pitch.min(high).max(low);
        let right = self.rotation[0];
        let up = self.up.try_normalize().unwrap_or(DVec3::NEG_Y);
        let spin = |v: DVec3| turned(turned(v, right, pitch), up, yaw);
        let arm = spin(self.position - center);
        self.rotation = self.rotation.map(spin);
        self.position = center + arm;
        self.touch();
    }

    /// Shifts by pixels of a picture of this height: the pivot follows the pointer.
    pub fn pan(&mut self, x: f64, y: f64, height: f64) {
        let scale = 2.0 * self.distance() * (0.5 * self.fov_y).tan() / height;
        self.shift(self.rotation[0] * (-x * scale) + self.rotation[1] * (-y * scale));
    }

    fn shift(&mut self, by: DVec3) {
        self.position += by;
        self.pivot += by;
        self.touch();
    }

    pub fn dolly(&mut self, factor: f64) {
        let arm = (self.position - self.pivot) * factor.clamp(0.2, 5.0);
        let nearest = NEAREST_SHARE * self.radius;
        let near = arm.length() < nearest;
        let arm = if near { arm.try_normalize().unwrap_or(-self.forward()) * nearest } else { arm };
        self.position = self.pivot + arm;
        self.touch();
    }

    /// Moves along the camera's axes, world units.
    pub fn fly(&mut self, v: DVec3) {
        self.shift(self.to_world(v));
    }

    /// Turns to a point, which becomes the pivot.
    pub fn face(&mut self, point: DVec3) {
        self.pivot = point;
        self.rotation = looking(point - self.position, self.up);
        self.touch();
    }

    /// Scale and corner (pixels) of a photo within a picture of this size.
    pub fn frame(lens: &Camera, [width, height]: [u32; 2]) -> (f64, [f64; 2]) {
        let (w, h) = (f64::from(lens.width), f64::from(lens.height));
        let (width, height) = (f64::from(width), f64::from(height));
        let scale = (width / w).min(height / h);
        (scale, [0.5 * (width - w * scale), 0.5 * (height - h * scale)])
    }

    pub fn camera(&self, size: [u32; 2]) -> Camera {
        let [width, height] = size;
        let rows = self.rotation.map(|row| row.as_vec3().to_array());
        let rotation = Mat3::from_cols_array_2d(&rows).transpose();
        let translation = DVec3::from_array(self.rotation.map(|row| -row.dot(self.position))).as_vec3();
        let intrinsics = match &self.lens {
            Some(lens) => {
                let (scale, [x, y]) = Self::frame(lens, size);
                let scaled = |length: f32, corner: f64| (corner + f64::from(length) * scale) as f32;
                let (fx, fy) = (scaled(lens.fx, 0.0), scaled(lens.fy, 0.0));
                Intrinsics { fx, fy, cx: scaled(lens.cx, x), cy: scaled(lens.cy, y), width, height }
            }
            None => {
                let f = (0.5 * f64::from(height) / (0.5 * self.fov_y).tan()) as f32;
                let (cx, cy) = (0.5 * width as f32, 0.5 * height as f32);
                Intrinsics { fx: f, fy: f, cx, cy, width, height }
            }
        };
        let camera = Camera::with_pose(rotation, translation, intrinsics);
        self.lens.as_ref().map_or(camera, |lens| camera.with_lens(lens.projection, &lens.coefficients))
    }
}

/// Turns `v` by an angle (radians) about a unit vector.
fn turned(v: DVec3, axis: DVec3, angle: f64) -> DVec3 {
    let (s, c) = angle.sin_cos();
    v * c + axis.cross(v) * s + axis * (axis.dot(v) * (1.0 - c))
}

/// Some direction perpendicular to `a`.
fn across(a: DVec3) -> DVec3 {
    let other = if a.x.abs() < 0.6 { DVec3::X } else { DVec3::Y };
    a.cross(other).try_normalize().unwrap_or(DVec3::X)
}

/// Axes of a camera that looks along `forward`.
fn looking(forward: DVec3, up: DVec3) -> [DVec3; 3] {
    let z = forward.try_normalize().unwrap_or(DVec3::Z);
    let x = z.cross(up);
    let x = if x.length() > 1e-6 { x.normalize() } else { across(z) };
    [x, z.cross(x), z]
}

/// Makes axes orthonormal again, because repeated turns add up errors.
fn orthonormal([_, y, z]: [DVec3; 3]) -> [DVec3; 3] {
    let forward = z.try_normalize().unwrap_or(DVec3::Z);
    let right = y.cross(forward).try_normalize().unwrap_or_else(|| across(forward));
    [right, forward.cross(right), forward]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Expected values come from `web/camera.js` after the same moves, run under Node.
    #[test]
    fn moves_are_those_of_the_page() {
        let mut view = Navigation::new(DVec3::new(0.5, -0.25, 1.0), DVec3::new(0.0, -1.0, 0.0), 3.0);
        let lens = Intrinsics { fx: 500.0, fy: 500.0, cx: 310.0, cy: 245.0, width: 640, height: 480 };
        let camera = Camera::look_at(
            glam::Vec3::new(1.0, -2.0, -3.0),
            glam::Vec3::new(0.0, 0.5, 0.0),
            glam::Vec3::NEG_Y,
            lens,
        );
        view.take(&camera, true);
        assert!(view.is_photo());
        let shown = view.camera([1280, 720]).intrinsics();
        assert_eq!([shown.fx, shown.cx, shown.cy], [750.0, 625.0, 367.5]);
        view.touch();
        view.orbit(0.3, -0.2);
        view.look(-0.1, 0.05);
        view.pan(20.0, -10.0, 720.0);
        view.dolly(1.4);
        view.fly(DVec3::new(0.1, 0.2, 0.3));
        let expected = [
            0.86694803,
            0.0,
            0.49839854,
            0.36404959,
            0.68297825,
            -0.63325240,
            -0.34039536,
            0.73043871,
            0.59210665,
            -0.28234870,
            -0.35682239,
            5.02932198,
            375.0,
        ];
        let camera = view.camera([640, 360]);
        let flat: Vec<f32> = camera.camera_from_world.transpose().to_cols_array().to_vec();
        let values = flat.into_iter().chain(camera.translation.to_array()).chain([camera.fx]);
        for (value, expected) in values.zip(expected) {
            assert!(
                (f64::from(value) - expected).abs() < 1e-5 * expected.abs().max(1.0),
                "{value} {expected}"
            );
        }
        // The view cannot pass a pole.
        (0..50).for_each(|_| view.orbit(0.0, 0.5));
        assert!(view.forward().dot(view.up).abs() < 1.0);
        view.face(DVec3::ZERO);
        let (x, y, _) = view.camera([640, 360]).project(glam::Vec3::ZERO);
        assert!((x - 320.0).abs() < 1e-2 && (y - 180.0).abs() < 1e-2, "{x} {y}");
    }
}
