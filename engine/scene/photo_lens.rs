//! A camera without its pose, in double precision: where a direction lies in its picture, and back.

use super::camera::{Camera, Intrinsics};
use super::lens::{Family, Projection, Surface, bisected};
use glam::{DMat2, DVec2, DVec3, Mat3, Vec3, dvec2};
use std::f64::consts::{FRAC_PI_2, PI};

/// The lens of the camera that took photographs, at their size.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PhotoLens {
    /// Focal lengths, pixels.
    pub focal_px: DVec2,
    /// Principal point, pixels (centre of the first pixel at 0.5).
    pub center_px: DVec2,
    /// Width of the image, pixels.
    pub width: u32,
    /// Height of the image, pixels.
    pub height: u32,
    /// Family of the lens.
    pub projection: Projection,
    /// Coefficients of the lens, in the order that [`Projection`] lists; zeros after the last.
    pub coefficients: [f64; 12],
}

/// Smallest and largest size of an undistorted image, as a share of the photograph's (COLMAP's defaults).
const SCALE_LIMITS: [f64; 2] = [0.2, 2.0];

/// Places between the middle and a point at which the lens is looked at for a fold.
const FOLD_SAMPLES: u32 = 64;

/// Number of focal lengths of each of COLMAP's models, its family, and the places of its other parameters among the coefficients.
const COLMAP_PARAMETERS: [(usize, Projection, &[usize]); 17] = {
    use Projection::{Brown, Division, Eucm, Fisheye, Fov, Perspective, ThinPrismFisheye};
    [
        (1, Perspective, &[]),
        (2, Perspective, &[]),
        (1, Brown, &[0]),
        (1, Brown, &[0, 1]),
        (2, Brown, &[0, 1, 2, 3]),
        (2, Fisheye, &[0, 1, 4, 5]),
        (2, Brown, &[0, 1, 2, 3, 4, 5, 6, 7]),
        (2, Fov, &[0]),
        (1, Fisheye, &[0]),
        (1, Fisheye, &[0, 1]),
        (2, Fisheye, &[0, 1, 2, 3, 4, 5, 6, 7]),
        (2, ThinPrismFisheye, &[0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11]),
        (1, Division, &[0]),
        (2, Division, &[0]),
        (1, Fisheye, &[]),
        (2, Fisheye, &[]),
        (2, Eucm, &[0, 1]),
    ]
};

/// Number of COLMAP's FULL_OPENCV.
const FULL_OPENCV: u32 = 6;
/// Number of COLMAP's EQUIRECTANGULAR, whose parameters are the width and the height.
const PANORAMA: u32 = 17;

/// Number of parameters of one of COLMAP's camera models, by its number. None for an unknown number.
pub fn colmap_parameters(model: u32) -> Option<usize> {
    match COLMAP_PARAMETERS.get(model as usize) {
        Some((focals, _, places)) => Some(focals + 2 + places.len()),
        None => (model == PANORAMA).then_some(2),
    }
}

impl PhotoLens {
    /// A pinhole without distortion.
    pub fn pinhole(intrinsics: Intrinsics) -> Self {
        let Intrinsics { fx, fy, cx, cy, width, height } = intrinsics;
        let [fx, fy, cx, cy] = [fx, fy, cx, cy].map(f64::from);
        let (focal_px, center_px) = (dvec2(fx, fy), dvec2(cx, cy));
        Self {
            focal_px,
            center_px,
            width,
            height,
            projection: Projection::Perspective,
            coefficients: [0.0; 12],
        }
    }

    /// A panorama of all directions.
    pub fn panorama(width: u32, height: u32) -> Self {
        let size = dvec2(width.into(), height.into());
        let (focal_px, center_px) = (size / dvec2(2.0 * PI, PI), 0.5 * size);
        let projection = Projection::Equirectangular;
        Self { focal_px, center_px, width, height, projection, coefficients: [0.0; 12] }
    }

    /// The lens of one of COLMAP's cameras, by the number and the parameters of its model. FULL_OPENCV may have a 13th parameter, n4
    /// of [`Projection::Brown`]. None for an unknown number, or another number of parameters.
    pub fn of_colmap(model: u32, parameters: &[f64], [width, height]: [u32; 2]) -> Option<Self> {
        if model == PANORAMA {
            return (parameters.len() == 2).then(|| Self::panorama(width, height));
        }
        let &(focals, projection, places) = COLMAP_PARAMETERS.get(model as usize)?;
        let (optics, own) = parameters.split_at_checked(focals + 2)?;
        let places =
            if model == FULL_OPENCV && own.len() == 9 { &[0, 1, 2, 3, 4, 5, 6, 7, 8] } else { places };
        let mut coefficients = [0.0; 12];
        places.iter().zip(own).for_each(|(&place, own)| coefficients[place] = *own);
        let [fx, fy, cx, cy] = [0, focals - 1, focals, focals + 1].map(|index| optics[index]);
        let (focal_px, center_px) = (dvec2(fx, fy), dvec2(cx, cy));
        let lens = Self { focal_px, center_px, width, height, projection, coefficients };
        (own.len() == places.len()).then(|| lens.without_zeros())
    }

    /// Number and parameters of the model of COLMAP that has this lens and the fewest parameters. None if no model has it.
    pub fn to_colmap(&self) -> Option<(u32, Vec<f64>)> {
        /// Models with two focal lengths, the simpler ones of a family first.
        const MODELS: [u32; 9] = [1, 4, 6, 5, 10, 11, 7, 13, 16];
        if self.projection == Projection::Equirectangular {
            return Some((PANORAMA, vec![self.width.into(), self.height.into()]));
        }
        let (model, places) = MODELS.into_iter().find_map(|model| {
            let (_, projection, places) = COLMAP_PARAMETERS[model as usize];
            let has = |(place, &value): (usize, &f64)| value == 0.0 || places.contains(&place);
            let fits = projection == self.projection && self.coefficients.iter().enumerate().all(has);
            fits.then_some((model, places))
        })?;
        let optics = [self.focal_px.to_array(), self.center_px.to_array()].concat();
        Some((
            model,
            optics.into_iter().chain(places.iter().map(|&place| self.coefficients[place])).collect(),
        ))
    }

    /// The lens, or a pinhole if it does not distort.
    #[must_use]
    pub fn without_zeros(self) -> Self {
        // Eucm distorts by α, the others by any coefficient.
        let distorts = match self.projection {
            Projection::Eucm => self.coefficients[0] != 0.0,
            _ => self.coefficients != [0.0; 12],
        };
        match self.projection.surface() == Some(Surface::Plane) && !distorts {
            true => Self { projection: Projection::Perspective, coefficients: [0.0; 12], ..self },
            false => self,
        }
    }

    /// Returns the focal lengths, the principal point and the size, in single precision.
    pub fn intrinsics(&self) -> Intrinsics {
        let (focal, center) = (self.focal_px.as_vec2(), self.center_px.as_vec2());
        let (width, height) = (self.width, self.height);
        Intrinsics { fx: focal.x, fy: focal.y, cx: center.x, cy: center.y, width, height }
    }

    /// The camera with this lens and a pose from world to camera.
    pub fn camera(&self, camera_from_world: Mat3, translation: Vec3) -> Camera {
        let coefficients = self.coefficients.map(|c| c as f32);
        Camera::with_pose(camera_from_world, translation, self.intrinsics())
            .with_lens(self.projection, &coefficients)
    }

    /// Returns the same lens at another image size.
    pub fn scaled_to(&self, width: u32, height: u32) -> Self {
        let scale =
            dvec2(f64::from(width) / f64::from(self.width), f64::from(height) / f64::from(self.height));
        Self { focal_px: self.focal_px * scale, center_px: self.center_px * scale, width, height, ..*self }
    }

    /// Point of the plane or of the angles that the lens distorts, and which shows a point in camera space. None behind a plane.
    pub(super) fn place(&self, at: DVec3) -> Option<DVec2> {
        let (rho, across) = (at.truncate().length(), at.truncate());
        match self.projection.surface() {
            _ if self.projection == Projection::Orthographic => Some(across),
            None | Some(Surface::Plane) => (at.z > 0.0).then(|| across / at.z),
            Some(Surface::Angle) => {
                let ratio = if rho > 0.0 { rho.atan2(at.z) / rho } else { 1.0 / at.z };
                (at != DVec3::ZERO && ratio.is_finite()).then(|| across * ratio)
            }
            Some(Surface::Sphere) => {
                let h = dvec2(at.x, at.z).length();
                (h > 1e-6 * at.length()).then(|| dvec2(at.x.atan2(at.z), at.y.atan2(h)))
            }
        }
    }

    /// Direction that a point of the plane or of the angles shows, of length 1.
    fn direction(&self, place: DVec2) -> DVec3 {
        match self.projection.surface() {
            _ if self.projection == Projection::Orthographic => DVec3::Z,
            None | Some(Surface::Plane) => place.extend(1.0).normalize(),
            Some(Surface::Angle) => {
                let angle = place.length();
                let ratio = if angle > 0.0 { angle.sin() / angle } else { 1.0 };
                (place * ratio).extend(angle.cos())
            }
            Some(Surface::Sphere) => {
                let ([sin, cos], [up, across]) =
                    ([place.x.sin(), place.x.cos()], [place.y.sin(), place.y.cos()]);
                DVec3::new(across * sin, up, across * cos)
            }
        }
    }

    fn distorted(&self, family: &Family, place: DVec2) -> DVec2 {
        let radial = place * (family.radial)(&self.coefficients, place.length_squared())[0];
        radial + (family.bend)(&self.coefficients, place, radial)
    }

    /// Picture position of a point of the plane or of the angles, pixels.
    pub(super) fn position_of(&self, place: DVec2) -> DVec2 {
        let distorted = self.projection.family().map_or(place, |family| self.distorted(family, place));
        self.focal_px * distorted + self.center_px
    }

    /// Picture position of a point in camera space, pixels (first pixel's centre at 0.5). None where the lens shows nothing:
    /// behind a plane, or beyond a fold of the distortion.
    pub fn project(&self, at: DVec3) -> Option<DVec2> {
        let place = self.place(at)?;
        self.is_sound_up_to(place).then(|| self.position_of(place))
    }

    /// True if the picture shows a point in camera space.
    pub fn shows(&self, at: DVec3) -> bool {
        let inside = |position: DVec2| {
            let size = dvec2(self.width.into(), self.height.into());
            position.cmpge(DVec2::ZERO).all() && position.cmplt(size).all()
        };
        // Most points are far outside: looking for folds is expensive.
        self.place(at).is_some_and(|place| inside(self.position_of(place)) && self.is_sound_up_to(place))
    }

    /// Same as [`PhotoLens::project`], without looking for folds.
    pub fn position(&self, at: DVec3) -> Option<DVec2> {
        Some(self.position_of(self.place(at)?))
    }

    /// True if the radial term does not fold the picture between its middle and a point.
    fn is_sound_up_to(&self, place: DVec2) -> bool {
        let Some(family) = self.projection.family() else { return true };
        let part = place.length() / f64::from(FOLD_SAMPLES);
        (1..=FOLD_SAMPLES).all(|sample| family.is_sound(&self.coefficients, f64::from(sample) * part))
    }

    /// Direction in camera space that a picture position shows, of length 1. None if the lens shows none there. See
    /// [`PhotoLens::rays`] for many.
    pub fn ray(&self, pixel: DVec2) -> Option<DVec3> {
        self.rays()(pixel)
    }

    /// The function of [`PhotoLens::ray`], which looks for the lens's fold only once.
    pub fn rays(&self) -> impl Fn(DVec2) -> Option<DVec3> + Send + Sync + use<> {
        let lens = *self;
        let family = lens.projection.family();
        let reach = family.map_or([0.0; 2], |family| {
            let end = family.fold(&lens.coefficients).min(1e9);
            [end, family.radius(&lens.coefficients, end)]
        });
        move |pixel| {
            let distorted = (pixel - lens.center_px) / lens.focal_px;
            match family {
                None => Some(lens.direction(distorted)),
                Some(family) if family.surface == Surface::Sphere => {
                    let shown = distorted.x.abs() <= PI && distorted.y.abs() <= FRAC_PI_2;
                    shown.then(|| lens.direction(distorted))
                }
                Some(family) => lens.undistorted(family, distorted, reach).map(|place| lens.direction(place)),
            }
        }
    }

    /// Point that the lens distorts to another one. `end` is the distance from the middle at which the radial term ends, and `reach`
    /// where it brings that.
    fn undistorted(&self, family: &Family, distorted: DVec2, [end, reach]: [f64; 2]) -> Option<DVec2> {
        /// The tangential and prism terms are small: Newton's steps converge in a few.
        const STEPS: usize = 50;
        let (far, c) = (distorted.length(), &self.coefficients);
        // A tangential term may bring a place within reach.
        let start =
            if reach > far { bisected([0.0, end], |r| family.radius(c, r) < far) } else { 0.999 * end };
        let mut place = distorted * (start / far.max(f64::MIN_POSITIVE));
        for _ in 0..STEPS {
            let h = 1e-6 * place.length().max(1.0);
            let by = |axis: DVec2| {
                (self.distorted(family, place + h * axis) - self.distorted(family, place - h * axis))
                    / (2.0 * h)
            };
            let slopes = DMat2::from_cols(by(DVec2::X), by(DVec2::Y));
            let step = slopes.inverse() * (self.distorted(family, place) - distorted);
            if !step.is_finite() {
                break;
            }
            // A longer step could cross a fold.
            place -= step.clamp_length_max(0.5 * place.length().max(0.5));
            if step.length_squared() < 1e-24 * place.length_squared().max(1.0) {
                break;
            }
        }
        let is_met = self.distorted(family, place).distance(distorted) < 1e-9 * far.max(1.0);
        (is_met && place.length() < end).then_some(place)
    }

    /// Largest distance from the middle that the radial term brings into a picture: an angle for fisheyes.
    pub(super) fn widest(&self) -> f64 {
        self.projection.family().map_or(f64::INFINITY, |family| family.fold(&self.coefficients))
    }

    /// Largest pinhole camera whose image has no blank pixels: the same focal lengths, a smaller or larger image around the
    /// same direction. Equals `UndistortCamera` of COLMAP with its default. None if the lens shows more than a plane can, or
    /// folds the picture within the photograph or the pinhole's image.
    pub fn inscribed_pinhole(&self) -> Option<Intrinsics> {
        if self.projection == Projection::Perspective {
            return Some(self.intrinsics());
        }
        let (width, height) = (f64::from(self.width), f64::from(self.height));
        let [columns, rows] = [self.width, self.height].map(|n| (0..n).map(|i| f64::from(i) + 0.5));
        let rays = self.rays();
        let ideal = |x: f64, y: f64| {
            let ray = rays(dvec2(x, y)).filter(|ray| ray.z > 0.0)?;
            Some(self.focal_px * (ray.truncate() / ray.z) + self.center_px)
        };
        // Innermost positions of the photograph's four borders.
        let (mut left, mut right, mut top, mut bottom) = (f64::MIN, f64::MAX, f64::MIN, f64::MAX);
        for y in rows {
            left = left.max(ideal(0.5, y)?.x);
            right = right.min(ideal(width - 0.5, y)?.x);
        }
        for x in columns {
            top = top.max(ideal(x, 0.5)?.y);
            bottom = bottom.min(ideal(x, height - 0.5)?.y);
        }
        let side = |center: f64, length: f64, low: f64, high: f64, pixels: u32| {
            let larger = (center / (center - low)).max((length - 0.5 - center) / (high - center));
            let scale = (1.0 / larger).clamp(SCALE_LIMITS[0], SCALE_LIMITS[1]);
            ((scale * f64::from(pixels)) as u32).max(1)
        };
        let new_width = side(self.center_px.x, width, left, right, self.width);
        let new_height = side(self.center_px.y, height, top, bottom, self.height);
        let center_px = self.center_px * dvec2(f64::from(new_width) / width, f64::from(new_height) / height);
        let pinhole = Self {
            center_px,
            width: new_width,
            height: new_height,
            projection: Projection::Perspective,
            coefficients: [0.0; 12],
            ..*self
        };
        let (w, h) = (f64::from(new_width), f64::from(new_height));
        let corners = [[0.5, 0.5], [w - 0.5, 0.5], [0.5, h - 0.5], [w - 0.5, h - 0.5]];
        let is_whole =
            |corner: [f64; 2]| pinhole.ray(corner.into()).is_some_and(|ray| self.project(ray).is_some());
        corners.into_iter().all(is_whole).then(|| pinhole.intrinsics())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Directions over the whole of each lens's view come back from where it shows them.
    #[test]
    fn rays_are_inverse_to_projection() {
        let fisheye = [200.0, 210.0, 161.0, 119.0];
        let plane = [150.0, 160.0, 158.0, 121.0];
        let of = |model: u32, optics: [f64; 4], own: &[f64]| {
            let parameters = [&optics[..], own].concat();
            (PhotoLens::of_colmap(model, &parameters, [320, 240]).expect("a lens"), optics == fisheye)
        };
        let lenses = [
            of(1, plane, &[]),
            of(4, plane, &[-0.12, 0.02, 0.003, -0.002]),
            of(5, fisheye, &[0.05, -0.01, 0.003, -0.0005]),
            of(6, plane, &[0.1, 0.02, 0.001, -0.002, 0.01, 0.05, 0.01, 0.003]),
            of(7, plane, &[0.9]),
            of(10, fisheye, &[0.02, -0.003, 0.001, 0.002, 0.0, 0.0, 0.001, -0.002]),
            of(11, fisheye, &[0.02, -0.01, 0.0, 0.0, 0.0, 0.0, 0.001, 0.0, 0.001, 0.0, 0.0, 0.001]),
            of(13, plane, &[-0.1]),
            of(16, plane, &[0.6, 1.1]),
            (PhotoLens::panorama(320, 160), true),
        ];
        for (lens, sees_behind) in lenses {
            let (model, parameters) = lens.to_colmap().expect("a model");
            assert_eq!(PhotoLens::of_colmap(model, &parameters, [lens.width, lens.height]), Some(lens));
            let widest = if sees_behind { 1.75 } else { 0.8 };
            for (angle, turn) in (0..20).flat_map(|a| (0..12).map(move |t| (a, t))) {
                let (angle, turn) = (f64::from(angle) / 19.0 * widest, f64::from(turn) * 0.55 + 0.1);
                let at = DVec3::new(angle.sin() * turn.cos(), angle.sin() * turn.sin(), angle.cos());
                let pixel = lens.project(7.0 * at).unwrap_or_else(|| panic!("{lens:?} does not show {at}"));
                let ray = lens.ray(pixel).unwrap_or_else(|| panic!("{lens:?} has no ray at {pixel}"));
                assert!(ray.distance(at) < 1e-9, "{lens:?}: {at} comes back as {ray}");
            }
        }
    }

    #[test]
    fn places_that_nothing_reaches_have_no_ray() {
        let of = |model: u32, own: &[f64]| {
            let parameters = [&[100.0, 100.0, 160.0, 120.0][..], own].concat();
            PhotoLens::of_colmap(model, &parameters, [320, 240]).expect("a lens")
        };
        // A direction of half a circle is the last that a fisheye shows.
        assert!(of(15, &[]).ray(dvec2(160.0 + 100.0 * PI + 0.1, 120.0)).is_none());
        assert!(of(15, &[]).ray(dvec2(160.0 + 100.0 * PI - 0.1, 120.0)).is_some());
        // r - r³ / 3 rises up to r = 1.
        let folding = of(4, &[-1.0 / 3.0, 0.0, 0.0, 0.0]);
        assert!(folding.ray(dvec2(160.0 + 66.0, 120.0)).is_some());
        assert!(folding.ray(dvec2(160.0 + 67.0, 120.0)).is_none());
        assert!(folding.project(DVec3::new(1.1, 0.0, 1.0)).is_none());
        assert!(PhotoLens::panorama(64, 32).ray(dvec2(65.0, 3.0)).is_none());
    }
}
