//! Cameras with lens distortion, and the pinhole cameras that replace them.

use glam::{DMat2, DVec2, dvec2};

use super::camera::Intrinsics;

/// Distortion of the point (x/z, y/z) of the image plane by a lens.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Distortion {
    /// No distortion.
    None,
    /// Brown's model, with r² = u² + v²: the radial factor (1 + k₀ r² + k₁ r⁴ + k₂ r⁶ + k₃ r⁸) / (1 + d₀ r² +
    /// d₁ r⁴ + d₂ r⁶) and the tangential term (2 p₀ u v + p₁ (r² + 2 u²), 2 p₁ u v + p₀ (r² + 2 v²)).
    /// OpenCV's and COLMAP's perspective models are special cases.
    Brown {
        /// Coefficients of the numerator.
        k: [f64; 4],
        /// Coefficients of the denominator.
        d: [f64; 3],
        /// Tangential coefficients.
        p: [f64; 2],
    },
    /// Equidistant, with θ = atan r: the point lies at θ (1 + k₀ θ² + k₁ θ⁴ + k₂ θ⁶ + k₃ θ⁸) from the middle.
    Fisheye {
        /// Coefficients.
        k: [f64; 4],
    },
}

impl Distortion {
    /// Returns the distorted position of a point of the image plane.
    pub fn apply(&self, point: DVec2) -> DVec2 {
        let r2 = point.length_squared();
        match *self {
            Self::None => point,
            Self::Brown { k, d, p } => {
                let above = 1.0 + r2 * (k[0] + r2 * (k[1] + r2 * (k[2] + r2 * k[3])));
                let below = 1.0 + r2 * (d[0] + r2 * (d[1] + r2 * d[2]));
                let DVec2 { x: u, y: v } = point;
                let tangential = dvec2(
                    2.0 * p[0] * u * v + p[1] * (r2 + 2.0 * u * u),
                    2.0 * p[1] * u * v + p[0] * (r2 + 2.0 * v * v),
                );
                point * (above / below) + tangential
            }
            Self::Fisheye { k } => {
                let r = r2.sqrt();
                if r < 1e-9 {
                    return point;
                }
                let theta = r.atan();
                let t2 = theta * theta;
                let distorted = theta * (1.0 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3]))));
                point * (distorted / r)
            }
        }
    }

    /// Returns the undistorted point of a distorted one. None if there is none nearby: the lens shows more than a plane can.
    pub fn undo(&self, distorted: DVec2) -> Option<DVec2> {
        const STEPS: usize = 100;
        const TOLERANCE: f64 = 1e-10;
        let mut point = match self {
            // Wide lenses only converge from a good start.
            Self::Fisheye { .. } => {
                let theta = distorted.length();
                if theta > 0.0 { distorted * (theta.min(1.5).tan() / theta) } else { distorted }
            }
            _ => distorted,
        };
        if *self == Self::None {
            return Some(point);
        }
        for _ in 0..STEPS {
            let error = self.apply(point) - distorted;
            let step = self.jacobian(point).inverse() * error;
            if !step.is_finite() {
                return None;
            }
            // Steps are limited so that none crosses a fold.
            let longest = 0.5 * point.length().max(0.5);
            point -= step.clamp_length_max(longest);
            if step.length_squared() < TOLERANCE * TOLERANCE {
                break;
            }
        }
        (self.apply(point).distance(distorted) < 1e-6).then_some(point)
    }

    /// True if the picture folds between its middle and a point of the image plane. Points there appear twice, and the
    /// photograph does not tell which one it shows.
    pub fn folds_before(&self, point: DVec2) -> bool {
        const STEPS: u32 = 64;
        let at = |step: u32| point * (f64::from(step) / f64::from(STEPS));
        // False for NaN.
        let whole = |at: DVec2| self.apply(at).is_finite() && self.jacobian(at).determinant() > 0.0;
        !(0..=STEPS).all(|step| whole(at(step)))
    }

    /// Derivatives of [`Distortion::apply`] by finite differences.
    fn jacobian(&self, point: DVec2) -> DMat2 {
        let h = 1e-6 * point.length().max(1.0);
        let by = |axis: DVec2| (self.apply(point + h * axis) - self.apply(point - h * axis)) / (2.0 * h);
        DMat2::from_cols(by(DVec2::X), by(DVec2::Y))
    }
}

/// A camera without its pose, but with its lens.
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
    /// Distortion of the lens.
    pub distortion: Distortion,
}

/// Smallest and largest size of an undistorted image, as a share of the photograph's (COLMAP's defaults).
const SCALE_LIMITS: [f64; 2] = [0.2, 2.0];

impl PhotoLens {
    /// A pinhole without distortion.
    pub fn pinhole(intrinsics: Intrinsics) -> Self {
        let Intrinsics { fx, fy, cx, cy, width, height } = intrinsics;
        let [fx, fy, cx, cy] = [fx, fy, cx, cy].map(f64::from);
        Self {
            focal_px: dvec2(fx, fy),
            center_px: dvec2(cx, cy),
            width,
            height,
            distortion: Distortion::None,
        }
    }

    /// Returns the camera without its distortion.
    pub fn intrinsics(&self) -> Intrinsics {
        let (focal, center) = (self.focal_px.as_vec2(), self.center_px.as_vec2());
        Intrinsics {
            fx: focal.x,
            fy: focal.y,
            cx: center.x,
            cy: center.y,
            width: self.width,
            height: self.height,
        }
    }

    /// True if photographs must be undistorted.
    pub fn is_distorted(&self) -> bool {
        let none = |coefficients: &[f64]| coefficients.iter().all(|&c| c == 0.0);
        match &self.distortion {
            Distortion::None => false,
            Distortion::Brown { k, d, p } => !(none(k) && none(d) && none(p)),
            Distortion::Fisheye { .. } => true,
        }
    }

    /// Returns the same lens at another image size.
    pub fn scaled_to(&self, width: u32, height: u32) -> Self {
        let scale =
            dvec2(f64::from(width) / f64::from(self.width), f64::from(height) / f64::from(self.height));
        Self { focal_px: self.focal_px * scale, center_px: self.center_px * scale, width, height, ..*self }
    }

    /// Image position of a point (x/z, y/z), pixels.
    pub fn project(&self, point: DVec2) -> DVec2 {
        self.focal_px * self.distortion.apply(point) + self.center_px
    }

    /// Largest pinhole camera whose image has no blank pixels: the same focal lengths, a smaller or larger image around the
    /// same direction. Equals `UndistortCamera` of COLMAP with its default. None if the lens shows more than a plane can, or
    /// folds the picture within the photograph or the pinhole's image.
    pub fn inscribed_pinhole(&self) -> Option<Intrinsics> {
        if !self.is_distorted() {
            return Some(self.intrinsics());
        }
        let (width, height) = (f64::from(self.width), f64::from(self.height));
        let [columns, rows] = [self.width, self.height].map(|n| (0..n).map(|i| f64::from(i) + 0.5));
        let ideal = |x: f64, y: f64| {
            let point = self.distortion.undo((dvec2(x, y) - self.center_px) / self.focal_px)?;
            Some(self.focal_px * point + self.center_px)
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
        let center = self.center_px * dvec2(f64::from(new_width) / width, f64::from(new_height) / height);
        let pinhole = Self {
            center_px: center,
            width: new_width,
            height: new_height,
            distortion: Distortion::None,
            ..*self
        };
        let corners = |lens: &Self| {
            let (w, h) = (f64::from(lens.width), f64::from(lens.height));
            [[0.5, 0.5], [w - 0.5, 0.5], [0.5, h - 0.5], [w - 0.5, h - 0.5]].map(DVec2::from_array)
        };
        let seen = corners(self).map(|at| (ideal(at.x, at.y), self));
        let shown = corners(&pinhole).map(|at| (Some(at), &pinhole));
        for (place, camera) in seen.into_iter().chain(shown) {
            let point = (place? - camera.center_px) / camera.focal_px;
            if self.distortion.folds_before(point) {
                return None;
            }
        }
        Some(pinhole.intrinsics())
    }
}
