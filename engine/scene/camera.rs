//! A camera: its pose, projection and picture.

use crate::error::{Error, Result};
use glam::{DMat3, DQuat, DVec2, DVec3, Mat3, Vec2, Vec3};

use super::lens::{Coefficients, Projection};
use super::shutter::Shutter;
use super::strays::without_strays;

/// Largest accepted width or height of an image, pixels: JPEG's own limit. A larger value means a damaged file.
pub const MAX_IMAGE_SIDE: u32 = 65_535;

/// Minimum z of visible Gaussians, world units; the same as in the shaders.
pub const NEAR_PLANE: f32 = 0.2;

/// Plausible range of the focal length of a camera that took photographs, in image sizes.
const FOCAL_LENGTHS: [f32; 2] = [1e-3, 1e6];

/// Largest plausible distance of the principal point from the middle, in image sizes.
const PRINCIPAL_POINT: f32 = 100.0;

/// Largest plausible distance of a camera's centre from the origin, world units.
const FARTHEST: f32 = 1e9;

/// Largest deviation of `R Rᵀ` from the identity per element, for a camera's rotation.
const ORTHONORMAL_TOLERANCE: f32 = 1e-3;

/// Directions in which the projection is linearised at the Gaussian itself. Beyond, it is linearised at the limit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum JacobianLimit {
    /// Up to 0.3 tan(fov/2) outside the image's edges.
    #[default]
    Edge,
    /// ±1.3 tan(fov/2) around the optical axis. This is the reference's limit, also for off-centre cameras.
    Symmetric,
}

/// Margin of [`JacobianLimit::Edge`] and of the 3D filter (compute_3D_filter) outside the picture, as a share of its size.
pub(crate) const EDGE_MARGIN: f64 = 0.15;

/// Projection near a point: the rows of its Jacobian are `per_unit.x (1, 0, -slope.x)` and `per_unit.y (0, 1, -slope.y)`.
pub(crate) struct Linearised {
    /// Position on the screen, pixels (centre of the first pixel at 0.5).
    pub pixel: DVec2,
    /// Pixels per world unit across the axis.
    pub per_unit: DVec2,
    /// x/z and y/z; 0 for parallel rays.
    pub slope: DVec2,
}

/// A camera in COLMAP's and OpenCV's frame: x right, y down, z forward.
///
/// `x_camera = camera_from_world * x_world + translation`. A point projects to `(fx·x/z + cx, fy·y/z + cy)` pixels, or to
/// `(fx·x + cx, fy·y + cy)` if the camera is [orthographic](Projection::Orthographic). The centre of the first pixel is (0.5,
/// 0.5). Both kinds only draw Gaussians beyond z = [`NEAR_PLANE`]. [`Projection`] lists the lenses.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// Rotation from world to camera axes.
    pub camera_from_world: Mat3,
    /// Translation from world to camera, world units.
    pub translation: Vec3,
    /// Focal length in x, pixels; pixels per world unit if orthographic.
    pub fx: f32,
    /// Focal length in y, like `fx`.
    pub fy: f32,
    /// Principal point in x, pixels (centre of the first pixel at 0.5).
    pub cx: f32,
    /// Principal point in y, pixels (centre of the first pixel at 0.5).
    pub cy: f32,
    /// Width of the image, pixels.
    pub width: u32,
    /// Height of the image, pixels.
    pub height: u32,
    /// How directions reach the picture.
    pub projection: Projection,
    /// Coefficients of the projection's lens; zeros for other projections.
    pub coefficients: Coefficients,
    /// Place of the picture in a larger one: see [`Camera::part()`]. None for a whole picture.
    pub part: Option<PicturePart>,
    /// Rolling shutter. The pose above is then that halfway: see [`Camera::rolling`].
    pub shutter: Option<Shutter>,
}

/// A camera without its pose and projection: focal lengths, principal point and image size.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Intrinsics {
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

impl Intrinsics {
    /// Square pixels, principal point in the middle, `fov_x` radians from the left to the right edge.
    pub fn from_fov_x(fov_x: f32, width: u32, height: u32) -> Self {
        let focal = 0.5 * width as f32 / libm::tanf(0.5 * fov_x);
        Self { fx: focal, fy: focal, cx: 0.5 * width as f32, cy: 0.5 * height as f32, width, height }
    }

    /// Describes values that can be rendered, but that no camera that took photographs has.
    pub fn absurdity(&self) -> Option<String> {
        let axes = [("x", self.fx, self.cx, self.width), ("y", self.fy, self.cy, self.height)];
        axes.into_iter().find_map(|(axis, focal, center, side)| {
            let side_px = side as f32;
            if !(FOCAL_LENGTHS[0] * side_px..=FOCAL_LENGTHS[1] * side_px).contains(&focal) {
                return Some(format!("the focal length in {axis} is {focal} for {side} pixels"));
            }
            let off = (center - 0.5 * side_px).abs() > PRINCIPAL_POINT * side_px;
            off.then(|| format!("the principal point in {axis} is at {center} of {side} pixels"))
        })
    }
}

impl Camera {
    /// Describes a position that is finite, but too far away for single precision.
    pub fn absurdity(&self) -> Option<String> {
        let position = self.position();
        // False for NaN.
        let sane = position.length() <= FARTHEST;
        (!sane).then(|| format!("its camera is at {position}, farther than {FARTHEST:e} from the origin"))
    }

    /// Creates a camera from its pose in COLMAP's form. That is the quaternion (w, x, y, z) of the rotation from world to
    /// camera, of any length but zero, and the translation from world to camera.
    ///
    /// A zero or non-finite quaternion gives a camera that [`Camera::check`] refuses.
    pub fn from_colmap(quat_wxyz: [f64; 4], translation: [f64; 3], intrinsics: Intrinsics) -> Self {
        let [w, x, y, z] = quat_wxyz;
        let rotation = DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize());
        Self::with_pose(rotation.as_mat3(), DVec3::from_array(translation).as_vec3(), intrinsics)
    }

    /// Creates a camera at `eye` that looks at `target`; `up` is any world direction that is up in the image.
    ///
    /// If the camera looks straight along `up`, another direction is up.
    pub fn look_at(eye: Vec3, target: Vec3, up: Vec3, intrinsics: Intrinsics) -> Self {
        Self::look_from(eye.as_dvec3(), target.as_dvec3(), up.as_dvec3(), intrinsics)
    }

    /// Same as [`Camera::look_at`], but from double precision.
    pub fn look_from(eye: DVec3, target: DVec3, up: DVec3, intrinsics: Intrinsics) -> Self {
        let forward = (target - eye).try_normalize().unwrap_or(DVec3::Z);
        let right = forward.cross(up).try_normalize().unwrap_or_else(|| forward.any_orthonormal_vector());
        let down = forward.cross(right);
        Self::at(eye, DMat3::from_cols(right, down, forward).transpose(), intrinsics)
    }

    /// Creates a camera at `position` in the world, with a rotation from world to camera.
    ///
    /// The translation is computed from the rounded rotation, and is rounded once. Otherwise, far from the origin, the
    /// rotation's rounding would displace the camera.
    pub fn at(position: DVec3, camera_from_world: DMat3, intrinsics: Intrinsics) -> Self {
        Self::with_pose(Mat3::IDENTITY, Vec3::ZERO, intrinsics).moved_to(position, camera_from_world)
    }

    /// Same as [`Camera::at`], for a camera like this one.
    #[must_use]
    pub fn moved_to(&self, position: DVec3, camera_from_world: DMat3) -> Self {
        let camera_from_world = camera_from_world.as_mat3();
        let translation = -(camera_from_world.as_dmat3() * position);
        Self { camera_from_world, translation: translation.as_vec3(), ..*self }
    }

    /// Creates a pinhole from its world-to-camera pose.
    pub fn with_pose(camera_from_world: Mat3, translation: Vec3, intrinsics: Intrinsics) -> Self {
        let Intrinsics { fx, fy, cx, cy, width, height } = intrinsics;
        Self {
            camera_from_world,
            translation,
            fx,
            fy,
            cx,
            cy,
            width,
            height,
            projection: Projection::Perspective,
            coefficients: Coefficients::default(),
            part: None,
            shutter: None,
        }
    }

    /// Returns the camera with parallel rays. Its focal lengths then are pixels per world unit.
    pub fn orthographic(self) -> Self {
        let (projection, coefficients) = (Projection::Orthographic, Coefficients::default());
        Self { projection, coefficients, shutter: None, ..self }
    }

    /// True if the rays are parallel.
    pub fn is_orthographic(&self) -> bool {
        self.projection == Projection::Orthographic
    }

    /// Returns the camera without its pose and projection.
    pub fn intrinsics(&self) -> Intrinsics {
        let Self { fx, fy, cx, cy, width, height, .. } = *self;
        Intrinsics { fx, fy, cx, cy, width, height }
    }

    /// The camera's centre in world coordinates: `-Rᵀ t`.
    pub fn position(&self) -> Vec3 {
        -(self.camera_from_world.transpose() * self.translation)
    }

    /// Centre from which [`Camera::at`] computes the same translation, world coordinates.
    pub fn exact_position(&self) -> DVec3 {
        -(self.camera_from_world.as_dmat3().inverse() * self.translation.as_dvec3())
    }

    /// The viewing direction (+z of the camera) in world coordinates.
    pub fn forward(&self) -> Vec3 {
        self.camera_from_world.row(2)
    }

    /// True if a picture of this size has the camera's aspect, up to the rounding of a side.
    pub fn keeps_aspect_at(&self, width: u32, height: u32) -> bool {
        let [w, h, width, height] = [self.width, self.height, width, height].map(f64::from);
        (w * height / h - width).abs() <= 0.5 || (h * width / w - height).abs() <= 0.5
    }

    /// Returns the same view at another size, with pixels of the same shape. A picture of another aspect shows this view in its
    /// middle, and more at two of its sides. It is then no longer a part of a larger picture, and a rolling shutter reads this picture
    /// alone.
    pub fn fitted_to(&self, width: u32, height: u32) -> Self {
        if self.keeps_aspect_at(width, height) {
            return self.scaled_to(width, height);
        }
        let [w, h, wide, high] = [self.width, self.height, width, height].map(|side| side as f32);
        let scale = (wide / w).min(high / h);
        Self {
            fx: self.fx * scale,
            fy: self.fy * scale,
            cx: self.cx * scale + 0.5 * (wide - w * scale),
            cy: self.cy * scale + 0.5 * (high - h * scale),
            width,
            height,
            part: None,
            ..*self
        }
    }

    /// Returns the same view at another size: focal lengths and principal point scale with each axis. Another aspect stretches
    /// the picture: see [`Camera::fitted_to`].
    pub fn scaled_to(&self, width: u32, height: u32) -> Self {
        let (sx, sy) = (width as f32 / self.width as f32, height as f32 / self.height as f32);
        let part = self.part.map(|part| part.scaled_by([sx.into(), sy.into()], (width, height)));
        Self {
            fx: self.fx * sx,
            fy: self.fy * sy,
            cx: self.cx * sx,
            cy: self.cy * sy,
            width,
            height,
            part,
            ..*self
        }
    }

    /// Moves the camera within its image plane, world units along its own x (right) and y (down), for example to the other eye.
    /// Depths stay the same to the bit.
    pub fn moved_aside(&self, [x, y]: [f32; 2]) -> Self {
        Self { translation: self.translation - Vec3::new(x, y, 0.0), ..*self }
    }

    /// Pixel position of a world point (first pixel's centre at 0.5) and its [depth](Projection::depth_of), world units. NaN where a
    /// lens shows nothing.
    pub fn project(&self, world: Vec3) -> (f32, f32, f32) {
        let p = self.camera_from_world * world + self.translation;
        if self.has_lens() {
            let p = self.reading_of(p.as_dvec3()).unwrap_or(DVec3::NAN);
            let place = self.photo_lens().project(p).map_or(Vec2::NAN, |place| place.as_vec2());
            return (place.x, place.y, self.projection.depth_of(p) as f32);
        }
        let distance = self.distance_of(p.z.into()) as f32;
        (self.fx * p.x / distance + self.cx, self.fy * p.y / distance + self.cy, p.z)
    }

    /// Gives directions of picture positions (first pixel's centre at 0.5) in camera space, scaled to [depth](Projection::depth_of) 1.
    /// Straight ahead where a lens shows no direction. With a rolling shutter, camera space is that of [`Camera::time_of`] the position.
    pub fn rays(&self) -> impl Fn([f32; 2]) -> Vec3 + use<> {
        let (camera, lens) = (*self, self.projection.is_lens().then(|| self.photo_lens().rays()));
        move |[x, y]| match &lens {
            Some(rays) => {
                let ray = rays(DVec2::new(x.into(), y.into())).unwrap_or(DVec3::Z);
                (ray / camera.projection.depth_of(ray)).as_vec3()
            }
            None => Vec3::new((x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, 1.0),
        }
    }

    /// Gives the world points at picture positions and [depths](Projection::depth_of), along [`Camera::rays`].
    pub fn points(&self) -> impl Fn([f32; 2], f32) -> Vec3 + use<> {
        let (camera, rays) = (*self, self.rays());
        move |position, depth| {
            let own = camera.at_time(camera.time_of(Vec2::from(position).as_dvec2()));
            own.camera_from_world.transpose() * (depth * rays(position) - own.translation)
        }
    }

    /// Divisor of x and y in camera space, before the focal lengths: z, or 1 for parallel rays.
    pub fn distance_of(&self, z: f64) -> f64 {
        match self.projection {
            Projection::Orthographic => 1.0,
            _ => z,
        }
    }

    /// Projection near a point in camera space.
    pub(crate) fn linearised(&self, at: DVec3) -> Linearised {
        let distance = self.distance_of(at.z);
        let per_unit = DVec2::new(self.fx.into(), self.fy.into()) / distance;
        let slope = match self.projection {
            Projection::Orthographic => DVec2::ZERO,
            _ => at.truncate() / at.z,
        };
        let pixel = per_unit * at.truncate() + DVec2::new(self.cx.into(), self.cy.into());
        Linearised { pixel, per_unit, slope }
    }

    /// Range of x/z and range of y/z within the whole picture and a margin, a share of its size. Fisheyes and panoramas have none.
    pub(crate) fn shown_slopes(&self, margin: f64) -> Option<[[f64; 2]; 2]> {
        let whole = self.whole();
        if self.projection.orders_by_distance() {
            return None;
        }
        if self.projection.is_lens() {
            // Straight lines bend: the middles of the sides count beside the corners.
            let (rays, size) =
                (whole.photo_lens().rays(), DVec2::new(whole.width.into(), whole.height.into()));
            let places = [0.0, 0.5, 1.0].map(|x| [0.0, 0.5, 1.0].map(|y| rays(size * DVec2::new(x, y))));
            let slopes = places.into_iter().flatten().flatten().map(|ray| ray.truncate() / ray.z);
            let none = [DVec2::INFINITY, DVec2::NEG_INFINITY];
            let [low, high] = slopes.fold(none, |[low, high], slope| [low.min(slope), high.max(slope)]);
            let more = margin * (high - low);
            let (low, high) = (low - more, high + more);
            return Some([[low.x, high.x], [low.y, high.y]]);
        }
        let axis = |focal: f32, center: f32, size: u32| {
            let (focal, center, size) = (f64::from(focal), f64::from(center), f64::from(size));
            [-margin, 1.0 + margin].map(|share| (share * size - center) / focal)
        };
        Some([axis(whole.fx, whole.cx, whole.width), axis(whole.fy, whole.cy, whole.height)])
    }

    /// Limits of x/z and y/z (low, high, low, high) between which the projection is linearised.
    pub fn jacobian_limits(&self, limit: JacobianLimit) -> [f32; 4] {
        let whole = self.whole();
        let axis = |focal: f32, center: f32, size: u32| {
            let size = size as f32;
            let half_tan = size / (2.0 * focal);
            match limit {
                JacobianLimit::Edge => {
                    [-center / focal - 0.3 * half_tan, (size - center) / focal + 0.3 * half_tan]
                }
                JacobianLimit::Symmetric => [-1.3 * half_tan, 1.3 * half_tan],
            }
        };
        let [x_low, x_high] = axis(whole.fx, whole.cx, whole.width);
        let [y_low, y_high] = axis(whole.fy, whole.cy, whole.height);
        [x_low, x_high, y_low, y_high]
    }

    /// True for a world point in front of the camera and within its picture.
    pub fn sees(&self, world: Vec3) -> bool {
        if self.has_lens() {
            let halfway = (self.camera_from_world * world + self.translation).as_dvec3();
            return self.reading_of(halfway).is_some_and(|at| self.photo_lens().shows(at));
        }
        let (x, y, z) = self.project(world);
        let inside = |at: f32, side: u32| (0.0..side as f32).contains(&at);
        z > 0.0 && inside(x, self.width) && inside(y, self.height)
    }

    /// Checks that pictures of the camera have gradients.
    pub(crate) fn check_differentiable(&self) -> Result<()> {
        match self.projection {
            Projection::Orthographic => Err(Error::argument(
                "camera.projection",
                "is orthographic: gradients take rays through a point",
            )),
            _ => Ok(()),
        }
    }

    /// Refuses a camera that cannot be rendered: a number that is NaN or infinite, an image of no or absurd size, a focal length
    /// that is not positive, a `camera_from_world` that is not a rotation, or a lens whose distortion folds the picture.
    pub fn check(&self) -> Result<()> {
        match self.problem() {
            None => Ok(()),
            Some(problem) => Err(Error::argument("camera", problem)),
        }
    }

    /// Describes what is wrong with the camera, if anything.
    pub fn problem(&self) -> Option<String> {
        let Self { fx, fy, cx, cy, width, height, .. } = *self;
        let sides = 1..=MAX_IMAGE_SIDE;
        if !sides.contains(&width) || !sides.contains(&height) {
            return Some(format!("image size {width}x{height} is outside 1x1 to {MAX_IMAGE_SIDE} a side"));
        }
        if let Some(PicturePart { left, top, whole_width, whole_height }) =
            self.part.filter(|part| !part.holds(width, height))
        {
            let from = format!("image of {width}x{height} from ({left}, {top})");
            return Some(format!("{from} is no part of one of {whole_width}x{whole_height}"));
        }
        if !(fx.is_finite() && fy.is_finite() && fx > 0.0 && fy > 0.0) {
            return Some(format!("focal length ({fx}, {fy}) is not positive"));
        }
        if !(cx.is_finite() && cy.is_finite()) {
            return Some(format!("principal point ({cx}, {cy}) is not finite"));
        }
        if !(self.translation.is_finite() && self.camera_from_world.is_finite()) {
            return Some("pose is not finite".into());
        }
        let r = self.camera_from_world;
        if !is_rotation(r) {
            return Some("camera_from_world is not a rotation (orthonormal, determinant 1)".into());
        }
        self.shutter_problem().map(str::to_owned).or_else(|| self.lens_problem())
    }
}

/// True if a matrix is orthonormal with determinant 1, except for rounding.
#[inline]
pub(super) fn is_rotation(r: Mat3) -> bool {
    // Fast, because a frame checks thousands of poses. The other products are the same by symmetry.
    let Mat3 { x_axis: x, y_axis: y, z_axis: z } = r.transpose();
    let lengths = [x.dot(x) - 1.0, y.dot(y) - 1.0, z.dot(z) - 1.0];
    let angles = [x.dot(y), x.dot(z), y.dot(z)];
    // A sum of conditions without branches; numbers that are not finite fail it.
    let is_small = |value: f32| value.abs() <= ORTHONORMAL_TOLERANCE;
    lengths.into_iter().chain(angles).fold(true, |all, value| all & is_small(value))
        & (x.cross(y).dot(z) > 0.0)
}

/// Mean position of the cameras except [`strays`](super::strays()), world; None without cameras.
pub fn middle(positions: impl Iterator<Item = Vec3>) -> Option<DVec3> {
    mean(&without_strays(&positions.collect::<Vec<_>>(), |position| *position))
}

fn mean(positions: &[Vec3]) -> Option<DVec3> {
    let (sum, count) = positions.iter().fold((DVec3::ZERO, 0.0), |(s, n), p| (s + p.as_dvec3(), n + 1.0));
    (count > 0.0).then(|| sum / count)
}

/// Scene extent: 1.1 × the largest distance of a camera to the cameras' mean, world units; 0 for fewer than two cameras. Scales
/// the learning rate of the positions and densification (reference implementation, `getNerfppNorm`). Excludes
/// [`strays`](super::strays()).
pub fn scene_extent(positions: impl Iterator<Item = Vec3>) -> f32 {
    let positions = without_strays(&positions.collect::<Vec<_>>(), |position| *position);
    let Some(mean) = mean(&positions) else { return 0.0 };
    let largest = positions.iter().map(|p| p.as_dvec3().distance(mean)).fold(0.0, f64::max);
    (1.1 * largest) as f32
}

/// Place of a camera's picture in a larger one.
///
/// A part has the whole picture's pixels. The whole picture's edges bound the linearisation, the lens effects, the 3D filter and
/// the times of a rolling shutter. Sums of training (loss, statistics of densification) are the part's share of the whole's. So a
/// photograph can be trained where it shows a block of a scene. A picture that exceeds the device's memory can be rendered part by
/// part.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct PicturePart {
    /// Number of the whole picture's columns to the left of the part.
    pub left: u32,
    /// Number of the whole picture's rows above the part.
    pub top: u32,
    /// Width of the whole picture, pixels.
    pub whole_width: u32,
    /// Height of the whole picture, pixels.
    pub whole_height: u32,
}

impl PicturePart {
    /// True if a picture of this size fits there.
    fn holds(&self, width: u32, height: u32) -> bool {
        let fits = |from: u32, side: u32, whole: u32| from.checked_add(side).is_some_and(|end| end <= whole);
        fits(self.left, width, self.whole_width) && fits(self.top, height, self.whole_height)
    }

    /// Part at another scale of its picture, whose size becomes (width, height).
    fn scaled_by(&self, [sx, sy]: [f64; 2], (width, height): (u32, u32)) -> Self {
        let scaled = |length: u32, by: f64| (f64::from(length) * by).round() as u32;
        let (left, top) = (scaled(self.left, sx), scaled(self.top, sy));
        // The part must fit despite rounding.
        let whole_width = scaled(self.whole_width, sx).max(left + width);
        Self { left, top, whole_width, whole_height: scaled(self.whole_height, sy).max(top + height) }
    }
}

impl Camera {
    /// Camera of a part of this picture: `width` by `height` pixels from the column `left` and the row `top`. If both are
    /// multiples of 16, the part has the same tiles.
    ///
    /// # Errors
    /// [`Error::Argument`] for a part that is empty or exceeds the picture.
    pub fn part(&self, [left, top]: [u32; 2], [width, height]: [u32; 2]) -> Result<Self> {
        let here = PicturePart { left, top, whole_width: self.width, whole_height: self.height };
        if width == 0 || height == 0 || !here.holds(width, height) {
            let problem = format!(
                "{width}x{height} pixels from ({left}, {top}) are no part of {}x{}",
                self.width, self.height
            );
            return Err(Error::argument("part", problem));
        }
        let part = match self.part {
            Some(own) => PicturePart { left: own.left + left, top: own.top + top, ..own },
            None => here,
        };
        let (cx, cy) = (self.cx - left as f32, self.cy - top as f32);
        let is_smaller = width < part.whole_width || height < part.whole_height;
        Ok(Self { cx, cy, width, height, part: is_smaller.then_some(part), ..*self })
    }

    /// Camera of the whole picture; itself if it is whole.
    pub fn whole(&self) -> Self {
        let Some(PicturePart { left, top, whole_width, whole_height }) = self.part else { return *self };
        let (cx, cy) = (self.cx + left as f32, self.cy + top as f32);
        Self { cx, cy, width: whole_width, height: whole_height, part: None, ..*self }
    }

    /// True for sides where the picture is cut from a larger one: left, top, right, bottom.
    pub(crate) fn cut_sides(&self) -> [bool; 4] {
        self.part.map_or([false; 4], |PicturePart { left, top, whole_width, whole_height }| {
            [left > 0, top > 0, left + self.width < whole_width, top + self.height < whole_height]
        })
    }

    /// Number of pixels as a share of the whole picture's; 1 if it is whole.
    pub fn share_of_whole(&self) -> f64 {
        let pixels = |camera: &Self| f64::from(camera.width) * f64::from(camera.height);
        pixels(self) / pixels(&self.whole())
    }
}

#[cfg(test)]
mod picture_part_tests {
    use super::*;
    use crate::scene::Intrinsics;
    use glam::{Vec3, vec3};

    fn camera() -> Camera {
        let intrinsics = Intrinsics { cx: 70.25, ..Intrinsics::from_fov_x(0.8, 128, 96) };
        Camera::look_at(vec3(0.0, 0.0, -3.0), Vec3::ZERO, Vec3::NEG_Y, intrinsics)
    }

    #[test]
    fn a_part_has_the_wholes_pixels() {
        let whole = camera();
        let part = whole.part([32, 16], [48, 40]).expect("a part");
        let point = vec3(0.3, -0.2, 0.4);
        let (x, y, z) = whole.project(point);
        let (px, py, pz) = part.project(point);
        assert!((px - (x - 32.0)).abs() < 1e-4 && (py - (y - 16.0)).abs() < 1e-4 && pz == z);
        assert_eq!((part.width, part.height), (48, 40));
        assert_eq!(part.whole(), whole);
        assert_eq!(part.share_of_whole(), 48.0 * 40.0 / (128.0 * 96.0));
        let smaller = part.part([16, 0], [16, 16]).expect("a part of it");
        assert_eq!(smaller, whole.part([48, 16], [16, 16]).expect("the same"));
        assert!(part.check().is_ok() && smaller.check().is_ok());
        let corner = whole.part([80, 0], [48, 40]).expect("a part");
        let cut = [whole, part, corner].map(|camera| camera.cut_sides());
        assert_eq!(cut, [[false; 4], [true; 4], [true, false, false, true]]);
    }

    #[test]
    fn the_whole_is_no_part() {
        let whole = camera();
        assert_eq!(whole.part([0, 0], [128, 96]).expect("all of it"), whole);
        assert_eq!((whole.whole(), whole.share_of_whole()), (whole, 1.0));
    }

    #[test]
    fn what_is_no_part_is_refused() {
        for (corner, size) in
            [([0, 0], [129, 96]), ([64, 0], [65, 9]), ([0, 0], [0, 9]), ([0, u32::MAX], [9, 9])]
        {
            assert!(camera().part(corner, size).is_err(), "{corner:?} {size:?}");
        }
        let part = camera().part([64, 64], [32, 32]).expect("a part");
        let shifted = PicturePart { left: 100, ..part.part.expect("one") };
        assert!(Camera { part: Some(shifted), ..part }.check().is_err());
    }

    #[test]
    fn a_part_is_scaled_with_its_whole() {
        let part = camera().part([32, 16], [48, 40]).expect("a part");
        let half = part.scaled_to(24, 20);
        assert_eq!(half, camera().scaled_to(64, 48).part([16, 8], [24, 20]).expect("a part"));
    }
}
