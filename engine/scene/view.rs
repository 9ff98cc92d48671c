//! Converts a host engine's matrices to [`Camera`], with all conventions.
//!
//! A view and a projection matrix contain everything that differs between engines: the axes of view space, the direction of
//! clip space's y, reversed depth, and the far plane. So only the matrices and the flip of the viewport are necessary.

use glam::{Mat3, Mat4, Vec3, Vec4};

use super::camera::{MAX_IMAGE_SIDE, NEAR_PLANE, is_rotation};
use super::{Camera, Intrinsics};
use crate::error::{Error, Result};

/// Direction of clip space's +y in the image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ClipY {
    /// Down: Vulkan with a viewport of positive height.
    #[default]
    Down,
    /// Up: a viewport of negative height, or OpenGL's and Direct3D's clip space.
    Up,
}

/// View of a host: column vectors, `clip = projection * view * world`, depth from 0 to 1 in the viewport's whole range.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HostView {
    /// Transform from the scene's world to view space: a rotation, perhaps a mirroring of axes, and a translation. A scene's
    /// world is right-handed. A host with a left-handed world multiplies by the conversion: `view * diag(1, 1, -1, 1)`.
    pub view_from_world: Mat4,
    /// Perspective projection: any signs, off-centre or not, standard or reversed depth, finite or infinite far plane. Or an
    /// orthographic one: any signs, off-centre or not, standard or reversed depth, near plane in front of or behind the eye.
    pub clip_from_view: Mat4,
    /// Direction of clip space's +y in the image.
    pub clip_y: ClipY,
    /// Width of the image, pixels.
    pub width: u32,
    /// Height of the image, pixels.
    pub height: u32,
}

/// Meaning of the value `d` of a host's depth buffer: `1/z = scale * d + offset`, exact for every perspective projection, or `z
/// = scale * d + offset` for an orthographic one. z is the distance along the optical axis from the camera of
/// [`HostView::camera`], in world units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DepthMapping {
    /// Factor of `d`. For reversed depth it is positive for a perspective projection, and negative for an orthographic one.
    pub scale: f32,
    /// Offset of 1/z or z.
    pub offset: f32,
    /// Depth of a pixel without a surface: 1, or 0 for reversed depth.
    pub clear_value: f32,
    /// True if z itself is linear in d, as for an orthographic projection.
    pub linear: bool,
}

impl DepthMapping {
    /// Returns the z of a depth value; infinite for a far plane at infinity.
    pub fn z(&self, depth: f32) -> f32 {
        let value = self.scale * depth + self.offset;
        if self.linear { value } else { value.max(0.0).recip() }
    }

    /// Coefficients (a, b) of the inverse, for a host's shader that writes depth: `d = a / z + b`, or `d = a z + b` if the
    /// mapping is [`linear`](Self::linear). Not finite if `scale` is 0.
    pub fn coefficients(&self) -> [f32; 2] {
        let (scale, offset) = (f64::from(self.scale), f64::from(self.offset));
        [scale.recip() as f32, (-offset / scale) as f32]
    }

    /// Returns the depth value of a z, by [`coefficients`](Self::coefficients). It is outside 0 to 1 if z is not between the
    /// host's planes.
    pub fn depth(&self, z: f32) -> f32 {
        let [a, b] = self.coefficients();
        a * if self.linear { z } else { z.recip() } + b
    }
}

impl HostView {
    /// Returns the camera and the mapping of its depth buffer.
    ///
    /// The camera is the host's, with two exceptions for orthographic projections. It looks in the direction in which its axes
    /// are right-handed, for both directions of depth. Splats are only drawn beyond z = [`NEAR_PLANE`], so it may move back
    /// behind the host's eye until the near plane has that z. The mapping, and expected depth, count from there. Splats between
    /// that z and the host's near plane are not clipped.
    ///
    /// With parallel rays, a mirrored picture is that of the opposite direction, and is refused if the whole range of depth
    /// then lies behind the eye. An orthographic projection with a near plane behind the eye and a far plane in front must not
    /// mirror. It would be taken for one with the other direction of depth.
    ///
    /// # Errors
    /// [`Error::Argument`] for numbers that are not finite, a skewed projection or one that is neither perspective nor
    /// orthographic, a view that scales or is not affine, and matrices that together mirror the picture, with the exception
    /// above.
    pub fn camera(&self) -> Result<(Camera, DepthMapping)> {
        self.check()?;
        let (view, projection) = (self.view_from_world, self.clip_from_view);
        let p = |row: usize, column: usize| projection.col(column)[row];
        if p(3, 3) != 0.0 && [p(3, 0), p(3, 1), p(3, 2)] == [0.0; 3] {
            return self.orthographic();
        }
        // w = sign z_view, up to a common factor of the whole matrix.
        let w = p(3, 2);
        if w == 0.0 || p(3, 0) != 0.0 || p(3, 1) != 0.0 || p(3, 3) != 0.0 {
            let problem = format!(
                "is neither perspective nor orthographic: its last row is {}, it must be (0, 0, ±1, 0) or (0, 0, 0, 1)",
                projection.row(3)
            );
            return Err(Error::argument("clip_from_view", problem));
        }
        let zeros = [[0, 1], [1, 0], [2, 0], [2, 1], [0, 3], [1, 3]];
        check_zeros(projection, &zeros, [[0, 0], [1, 1], [2, 3]], "perspectives")?;
        let up = if self.clip_y == ClipY::Up { -1.0 } else { 1.0 };
        let (scale_x, scale_y) = (p(0, 0) / w.abs(), up * p(1, 1) / w.abs());
        // Axes of the camera (x right, y down, z forward) in view space.
        let axes = Vec3::new(scale_x.signum(), scale_y.signum(), w.signum());
        let view_rotation = Mat3::from_mat4(view);
        let camera_from_world = Mat3::from_diagonal(axes) * view_rotation;
        if camera_from_world.determinant() < 0.0 {
            return mirrored();
        }
        let (width, height) = (self.width as f32, self.height as f32);
        let intrinsics = Intrinsics {
            fx: 0.5 * width * scale_x.abs(),
            fy: 0.5 * height * scale_y.abs(),
            cx: 0.5 * width * (1.0 + p(0, 2) / w),
            cy: 0.5 * height * (1.0 + up * p(1, 2) / w),
            width: self.width,
            height: self.height,
        };
        let translation = axes * view.w_axis.truncate();
        let camera = Camera::with_pose(camera_from_world, translation, intrinsics);
        camera.check().map_err(|error| error.of("clip_from_view"))?;
        // d = (p22 z_view + p23) / (w z_view), and z_view = sign(w) z.
        let scale = w.abs() / p(2, 3);
        let mapping = DepthMapping {
            scale,
            offset: -p(2, 2) * w.signum() / p(2, 3),
            clear_value: if scale > 0.0 { 0.0 } else { 1.0 },
            linear: false,
        };
        Ok((camera, mapping))
    }

    /// Checks each field, except the kind of projection.
    fn check(&self) -> Result<()> {
        let (view, projection) = (self.view_from_world, self.clip_from_view);
        for (field, matrix) in [("view_from_world", view), ("clip_from_view", projection)] {
            if let Some([row, column]) = find(matrix, |value| !value.is_finite()) {
                let problem = format!("row {row}, column {column} is {}", matrix.col(column)[row]);
                return Err(Error::argument(field, problem));
            }
        }
        if !is_affine(view) {
            let problem = format!("its last row is {}, not (0, 0, 0, 1)", view.row(3));
            return Err(Error::argument("view_from_world", problem));
        }
        let rotation = Mat3::from_mat4(view);
        // Axes may be mirrored.
        if !is_rotation(rotation * rotation.determinant().signum()) {
            let problem = format!("{rotation} is not a rotation, with or without a mirroring of axes");
            return Err(Error::argument("view_from_world", problem));
        }
        for (field, side) in [("width", self.width), ("height", self.height)] {
            if !(1..=MAX_IMAGE_SIDE).contains(&side) {
                return Err(Error::argument(field, format!("{side}, it may be 1 to {MAX_IMAGE_SIDE}")));
            }
        }
        Ok(())
    }

    /// Same as [`HostView::camera`], for a projection with the last row (0, 0, 0, w).
    fn orthographic(&self) -> Result<(Camera, DepthMapping)> {
        let projection = self.clip_from_view;
        let p = |row: usize, column: usize| f64::from(projection.col(column)[row] / projection.col(3)[3]);
        let zeros = [[0, 1], [0, 2], [1, 0], [1, 2], [2, 0], [2, 1]];
        check_zeros(projection, &zeros, [[0, 0], [1, 1], [2, 2]], "orthographic ones")?;
        let up = if self.clip_y == ClipY::Up { -1.0 } else { 1.0 };
        let (scale_x, scale_y) = (p(0, 0), up * p(1, 1));
        let view_rotation = Mat3::from_mat4(self.view_from_world);
        // Two axes of the picture and the handedness determine the third.
        let handed = scale_x.signum() * scale_y.signum() * f64::from(view_rotation.determinant().signum());
        let axes = Vec3::new(scale_x.signum() as f32, scale_y.signum() as f32, handed as f32);
        // d = p22 z_view + p23, and z_view = handed z.
        let z_of = |depth: f64| handed * (depth - p(2, 3)) / p(2, 2);
        let (near, far) = (z_of(0.0).min(z_of(1.0)), z_of(0.0).max(z_of(1.0)));
        if far <= 0.0 {
            return mirrored();
        }
        let behind = (f64::from(NEAR_PLANE) - near).max(0.0);
        let (width, height) = (f64::from(self.width), f64::from(self.height));
        let intrinsics = Intrinsics {
            fx: (0.5 * width * scale_x.abs()) as f32,
            fy: (0.5 * height * scale_y.abs()) as f32,
            cx: (0.5 * width * (1.0 + p(0, 3))) as f32,
            cy: (0.5 * height * (1.0 + up * p(1, 3))) as f32,
            width: self.width,
            height: self.height,
        };
        let mut translation = axes * self.view_from_world.w_axis.truncate();
        translation.z += behind as f32;
        let camera = Camera::with_pose(Mat3::from_diagonal(axes) * view_rotation, translation, intrinsics);
        camera.check().map_err(|error| error.of("clip_from_view"))?;
        let mapping = DepthMapping {
            scale: (z_of(1.0) - z_of(0.0)) as f32,
            offset: (z_of(0.0) + behind) as f32,
            clear_value: if z_of(1.0) < z_of(0.0) { 0.0 } else { 1.0 },
            linear: true,
        };
        Ok((camera.orthographic(), mapping))
    }
}

/// Error for matrices that show a mirror image.
fn mirrored<T>() -> Result<T> {
    let problem = "together they mirror the picture: check clip_y; for a left-handed world, multiply view_from_world by what \
                   takes the scene there, for example diag(1, 1, -1, 1)";
    Err(Error::argument("view_from_world, clip_from_view, clip_y", problem))
}

/// Row and column of the first element for which `is_it` is true.
fn find(matrix: Mat4, is_it: impl Fn(f32) -> bool) -> Option<[usize; 2]> {
    (0..16).map(|i| [i / 4, i % 4]).find(|&[row, column]| is_it(matrix.col(column)[row]))
}

/// Refuses a projection with nonzero elements at `zeros`, or a zero at one of `others`.
fn check_zeros(projection: Mat4, zeros: &[[usize; 2]], others: [[usize; 2]; 3], kind: &str) -> Result<()> {
    let value = |[row, column]: [usize; 2]| projection.col(column)[row];
    let skewed = zeros.iter().find(|&&place| value(place) != 0.0);
    let Some(&place) = skewed.or_else(|| others.iter().find(|&&place| value(place) == 0.0)) else {
        return Ok(());
    };
    let ([row, column], value) = (place, value(place));
    let problem = format!(
        "is skewed or degenerate: row {row}, column {column} is {value}, only off-centre {kind} are possible"
    );
    Err(Error::argument("clip_from_view", problem))
}

/// True if a matrix's last row is (0, 0, 0, 1), except for the rounding of an inverse.
fn is_affine(matrix: Mat4) -> bool {
    matrix.row(3).abs_diff_eq(Vec4::W, 1e-5)
}

/// Pose of an object in the world: `x_world = scale * rotation * x_object + translation`.
///
/// The scale is uniform. A non-uniform scale would change the rotations, extents and view-dependent colours of Gaussians.
/// [`Gaussians::transform`](super::Gaussians::transform) changes the Gaussians themselves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Rotation from object to world.
    pub world_from_object: Mat3,
    /// Position of the object's origin, world units.
    pub translation: Vec3,
    /// World units per unit of the object; positive.
    pub scale: f32,
}

impl Pose {
    /// Identity of object and world.
    pub const IDENTITY: Self =
        Self { world_from_object: Mat3::IDENTITY, translation: Vec3::ZERO, scale: 1.0 };

    /// Creates a pose from a matrix with a rotation, a uniform scale and a translation.
    ///
    /// # Errors
    /// [`Error::Argument`] for a matrix that mirrors, shears, or does not scale uniformly.
    pub fn from_matrix(world_from_object: Mat4) -> Result<Self> {
        let m = Mat3::from_mat4(world_from_object);
        let scale = m.determinant().abs().cbrt();
        let pose = Self {
            world_from_object: m * scale.recip(),
            translation: world_from_object.w_axis.truncate(),
            scale,
        };
        match is_affine(world_from_object) {
            true => pose.check().map(|()| pose),
            false => Err(Error::argument("pose", "the matrix's last row is not (0, 0, 0, 1)")),
        }
    }

    /// Checks that the pose is valid.
    ///
    /// # Errors
    /// [`Error::Argument`] for numbers that are not finite, a scale that is not positive, or a matrix that is not a rotation.
    #[inline]
    pub fn check(&self) -> Result<()> {
        // is_rotation is false for numbers that are not finite.
        if is_rotation(self.world_from_object) & self.translation.is_finite() & self.has_possible_scale() {
            return Ok(());
        }
        Err(self.error())
    }

    /// True if the square of the scale and its inverse are normal numbers.
    #[inline]
    fn has_possible_scale(&self) -> bool {
        const MIN: f32 = f32::MIN_POSITIVE;
        let squared = self.scale * self.scale;
        (self.scale > 0.0) & (squared >= MIN) & (squared <= MIN.recip())
    }

    /// Describes the problem of a pose that fails its check.
    #[cold]
    fn error(&self) -> Error {
        let bad = |problem: &str| Error::argument("pose", problem);
        if !(self.world_from_object.is_finite() && self.translation.is_finite()) {
            return bad("holds numbers that are not finite");
        }
        match self.has_possible_scale() {
            true => bad("is not a rotation, a uniform scale and a translation"),
            false => bad(&format!("a scale of {} is not possible", self.scale)),
        }
    }

    /// Returns the camera in the object's axes and origin, in world units. Relative to it the object is neither turned nor
    /// moved, and its spherical harmonics are unchanged; the object is `scale` times as large.
    #[inline]
    pub fn camera_in_object(&self, camera: &Camera) -> Camera {
        if (Self { scale: 1.0, ..*self }) == Self::IDENTITY {
            return *camera;
        }
        Camera {
            camera_from_world: camera.camera_from_world * self.world_from_object,
            translation: camera.camera_from_world * self.translation + camera.translation,
            ..*camera
        }
    }
}

impl Default for Pose {
    fn default() -> Self {
        Self::IDENTITY
    }
}
