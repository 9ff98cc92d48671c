//! Lenses: how the directions of a camera reach its picture. One file per family, here and in glsl/include/lens/.

mod brown;
mod division;
mod equirectangular;
mod eucm;
mod fisheye;
mod fov;
mod thin_prism_fisheye;

use super::camera::{Camera, Intrinsics};
use glam::{DMat2, DVec2, DVec3, Mat3, Vec3, dvec2};
use std::f64::consts::{FRAC_PI_2, PI};

/// Declares projections and the list of them.
macro_rules! projections {
    ($(#[$about:meta])* pub enum $kind:ident { $($(#[$value_about:meta])* $value:ident,)* }) => {
        $(#[$about])*
        pub enum $kind { $($(#[$value_about])* $value,)* }

        impl $kind {
            /// All projections, in the order of their numbers.
            pub const ALL: [Self; [$(stringify!($value)),*].len()] = [$(Self::$value),*];
        }
    };
}

projections! {
    /// How the directions of a camera reach its picture: a pinhole, parallel rays, or a family of lenses.
    ///
    /// With p = (x, y, z) in camera space, a picture position is `(fx a' + cx, fy b' + cy)`. Lenses distort (a, b), which is (x, y)/z,
    /// or for fisheyes (x, y) θ/ρ with θ the angle from the axis and ρ = |(x, y)|. s = a² + b², and T(a, b) = (2 p1 a b + p2 (s + 2
    /// a²), 2 p2 a b + p1 (s + 2 b²)). [`Camera::coefficients`] are in the order of this list, which is COLMAP's.
    ///
    /// Fisheyes and panoramas see behind the camera. Their depths, also those of pictures and of a host's surfaces, are distances
    /// from the camera's centre. Means and covariances on the screen come from the unscented transform, not from the lens's
    /// Jacobian at the mean, which is worse for large Gaussians.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
    #[repr(u32)]
    pub enum Projection {
        /// Through one point, the camera's centre: a pinhole.
        #[default]
        Perspective,
        /// Parallel, along the camera's z axis, so that all Gaussians are seen from one direction. Only for rendered pictures:
        /// training photographs and gradients need another projection.
        Orthographic,
        /// (a, b) (1 + k1 s + k2 s² + k3 s³ + n4 s⁴) / (1 + k4 s + k5 s² + k6 s³) + T: k1 k2 p1 p2 k3 k4 k5 k6 n4. COLMAP's
        /// SIMPLE_RADIAL, RADIAL, OPENCV, FULL_OPENCV; nerfstudio's and Metashape's k4 is n4.
        Brown,
        /// (a, b) atan(2 r tan(ω/2)) / (r ω), r = √s: ω. COLMAP's FOV.
        Fov,
        /// (a, b) 2 / (1 + √(1 - 4 k s)): k. COLMAP's SIMPLE_DIVISION, DIVISION.
        Division,
        /// (a, b) / (α √(β s + 1) + 1 - α): α β. COLMAP's EUCM.
        Eucm,
        /// For fisheyes' (a, b): (a, b) (1 + k1 s + k2 s² + k3 s³ + k4 s⁴) + T + (sx1, sy1) s: k1 k2 p1 p2 k3 k4 sx1 sy1. COLMAP's
        /// OPENCV_FISHEYE, SIMPLE_RADIAL_FISHEYE, RADIAL_FISHEYE, THIN_PRISM_FISHEYE, SIMPLE_FISHEYE, FISHEYE.
        Fisheye,
        /// For fisheyes' (a, b): n + T(n; p1, p0) + (s0 S + s1 S², s2 S + s3 S²), n = (a, b) (1 + Σ ki s^(i+1)), S = n·n: k0 to k5 p0
        /// p1 s0 s1 s2 s3. COLMAP's RAD_TAN_THIN_PRISM_FISHEYE.
        ThinPrismFisheye,
        /// (a', b') are the longitude atan2(x, z) and the latitude atan2(y, √(x² + z²)): no coefficients. COLMAP's EQUIRECTANGULAR.
        Equirectangular,
    }
}

/// Names of COLMAP's camera models, by number: see [`Camera::with_colmap_lens`].
pub const COLMAP_MODELS: [&str; 18] = [
    "SIMPLE_PINHOLE",
    "PINHOLE",
    "SIMPLE_RADIAL",
    "RADIAL",
    "OPENCV",
    "OPENCV_FISHEYE",
    "FULL_OPENCV",
    "FOV",
    "SIMPLE_RADIAL_FISHEYE",
    "RADIAL_FISHEYE",
    "THIN_PRISM_FISHEYE",
    "RAD_TAN_THIN_PRISM_FISHEYE",
    "SIMPLE_DIVISION",
    "DIVISION",
    "SIMPLE_FISHEYE",
    "FISHEYE",
    "EUCM",
    "EQUIRECTANGULAR",
];

/// Coefficients of a lens, in the order that [`Projection`] lists; zeros after the last.
pub type Coefficients = [f32; 12];

/// Focal lengths, principal point and coefficients.
pub(crate) const LENS_PARAMETERS: usize = 16;

/// A family of lenses.
pub(super) struct Family {
    /// Name in files and errors.
    name: &'static str,
    /// Surface on which (a, b) lies.
    pub(super) surface: Surface,
    coefficients: usize,
    /// Places of the coefficients that refinement of the lens learns. It learns others if they are not 0.
    learned: &'static [usize],
    /// Radial factor g(s) and its derivative. Not finite or not positive where the lens is not defined.
    pub(super) radial: fn(&[f64; 12], f64) -> [f64; 2],
    /// Terms beside the radial one, of (a, b) and of its radially distorted position.
    pub(super) bend: fn(&[f64; 12], DVec2, DVec2) -> DVec2,
    /// Coefficients as the shader reads them.
    words: fn(&[f64; 12]) -> [f64; 12],
}

#[derive(Clone, Copy, PartialEq)]
pub(super) enum Surface {
    /// (x, y)/z.
    Plane,
    /// (x, y) θ/ρ.
    Angle,
    /// Longitude and latitude.
    Sphere,
}

/// A lens without terms beside its radial one, and with coefficients that the shader reads as they are.
const RADIAL: Family = Family {
    name: "",
    surface: Surface::Plane,
    coefficients: 0,
    learned: &[],
    radial: |_, _| [1.0, 0.0],
    bend: |_, _, _| DVec2::ZERO,
    words: |c| *c,
};

impl Projection {
    pub(super) fn family(self) -> Option<&'static Family> {
        match self {
            Self::Perspective | Self::Orthographic => None,
            Self::Brown => Some(&brown::FAMILY),
            Self::Fov => Some(&fov::FAMILY),
            Self::Division => Some(&division::FAMILY),
            Self::Eucm => Some(&eucm::FAMILY),
            Self::Fisheye => Some(&fisheye::FAMILY),
            Self::ThinPrismFisheye => Some(&thin_prism_fisheye::FAMILY),
            Self::Equirectangular => Some(&equirectangular::FAMILY),
        }
    }

    /// Name in files and errors.
    pub fn name(self) -> &'static str {
        match self {
            Self::Perspective => "perspective",
            Self::Orthographic => "orthographic",
            lens => lens.family().map_or("", |family| family.name),
        }
    }

    /// True if the picture continues from its right side to its left.
    pub(crate) fn has_seam(self) -> bool {
        self.surface() == Some(Surface::Sphere)
    }

    /// True if Gaussians are ordered by their distance instead of z.
    pub fn orders_by_distance(self) -> bool {
        matches!(self.surface(), Some(Surface::Angle | Surface::Sphere))
    }

    /// Depth by which Gaussians are ordered, for a point in camera space: z, or for fisheyes and panoramas the distance from the camera.
    pub fn depth_of(self, at: DVec3) -> f64 {
        if self.orders_by_distance() { at.length() } else { at.z }
    }

    pub(super) fn surface(self) -> Option<Surface> {
        self.family().map(|family| family.surface)
    }

    /// True for lenses: all projections but pinholes and parallel rays.
    pub fn is_lens(self) -> bool {
        self.family().is_some()
    }
}

/// Tangential term T(m; p1, p2).
fn tangential(m: DVec2, p1: f64, p2: f64) -> DVec2 {
    let s = m.length_squared();
    2.0 * m.x * m.y * dvec2(p1, p2) + dvec2(p2 * (s + 2.0 * m.x * m.x), p1 * (s + 2.0 * m.y * m.y))
}

/// Value and derivative of the polynomial 1 + k0 s + k1 s² + …
fn polynomial(k: &[f64], s: f64) -> [f64; 2] {
    let rise = |[value, slope]: [f64; 2], k: &f64| [value * s + k, slope * s + value];
    let [value, slope] = k.iter().rev().fold([0.0; 2], rise);
    [1.0 + s * value, value + s * slope]
}

/// Steps in which a fold is searched.
const FOLD_STEPS: u32 = 1024;

/// Share of the Jacobian's limit beyond the picture's corners (the reference's 1.3 tan(fov/2)).
const HOLD_MARGIN: f64 = 1.3;

/// Distance in the picture beyond which no point of the unscented transform may lie, as a multiple of the distance at which the Jacobian
/// is held.
const FAR: f64 = 1.6;

impl Family {
    /// Distance of a distorted point from the middle, by the radial term alone.
    pub(super) fn radius(&self, c: &[f64; 12], r: f64) -> f64 {
        r * (self.radial)(c, r * r)[0]
    }

    /// True if the radial term is defined and rises at a distance from the middle.
    pub(super) fn is_sound(&self, c: &[f64; 12], r: f64) -> bool {
        let [g, slope] = (self.radial)(c, r * r);
        g > 0.0 && g + 2.0 * r * r * slope > 0.0 && g.is_finite()
    }

    /// Smallest r > 0 at which the radial term folds the picture or is not defined; infinite, or for angles π, without one.
    pub(super) fn fold(&self, c: &[f64; 12]) -> f64 {
        let is_sound = |r: f64| self.is_sound(c, r);
        let [at, end]: [fn(f64) -> f64; 2] = match self.surface {
            Surface::Plane => [|share| (share * FRAC_PI_2).tan(), |_| f64::INFINITY],
            _ => [|share| share * PI, |_| PI],
        };
        let share = |step: u32| f64::from(step) / f64::from(FOLD_STEPS);
        let Some(step) = (1..FOLD_STEPS).find(|&step| !is_sound(at(share(step)))) else { return end(1.0) };
        bisected([at(share(step - 1)), at(share(step))], is_sound)
    }

    /// Largest r at which the Jacobian is taken, for pictures with corners at this distance from the middle.
    fn hold(&self, c: &[f64; 12], corner: f64, fold: f64) -> f64 {
        // A lens without a fold may bring all directions closer to the middle than the corner.
        let end = fold.min(1e9);
        match self.radius(c, end) > corner {
            true => HOLD_MARGIN * bisected([0.0, end], |r| self.radius(c, r) < corner),
            false => HOLD_MARGIN * fold,
        }
    }
}

/// Place between a place where a condition holds and one where it does not.
pub(super) fn bisected([mut low, mut high]: [f64; 2], holds: impl Fn(f64) -> bool) -> f64 {
    for _ in 0..80 {
        let middle = 0.5 * (low + high);
        *(if holds(middle) { &mut low } else { &mut high }) = middle;
    }
    0.5 * (low + high)
}

impl Camera {
    /// Returns the camera with a lens and its coefficients, in the order that [`Projection`] lists. [`Camera::check`] refuses
    /// coefficients that the lens does not have. Without distortion, a lens on the plane becomes a pinhole.
    #[must_use]
    pub fn with_lens(self, projection: Projection, coefficients: &[f32]) -> Self {
        let mut all = Coefficients::default();
        all.iter_mut().zip(coefficients).for_each(|(word, own)| *word = *own);
        let lens = Self { projection, coefficients: all, ..self }.photo_lens().without_zeros();
        Self { projection: lens.projection, coefficients: lens.coefficients.map(|c| c as f32), ..self }
    }

    /// Returns the camera with the lens of one of COLMAP's cameras: see [`PhotoLens::of_colmap`]. The pose and the size stay.
    pub fn with_colmap_lens(self, model: u32, parameters: &[f64]) -> Option<Self> {
        let lens = PhotoLens::of_colmap(model, parameters, [self.width, self.height])?;
        let own = lens.camera(self.camera_from_world, self.translation);
        Some(Self { part: self.part, shutter: self.shutter, ..own })
    }

    /// Returns the camera without its pose.
    pub fn photo_lens(&self) -> PhotoLens {
        let (projection, coefficients) = (self.projection, self.coefficients.map(f64::from));
        PhotoLens { projection, coefficients, ..PhotoLens::pinhole(self.intrinsics()) }
    }

    fn lens(&self) -> Option<(&'static Family, [f64; 12])> {
        Some((self.projection.family()?, self.coefficients.map(f64::from)))
    }

    /// Largest distance of the whole picture's corners from the middle, in focal lengths.
    fn corner(&self) -> f64 {
        let whole = self.whole();
        let far = |center: f32, side: u32, focal: f32| {
            f64::from(center).abs().max((f64::from(side) - f64::from(center)).abs()) / f64::from(focal)
        };
        DVec2::new(far(whole.cx, whole.width, whole.fx), far(whole.cy, whole.height, whole.fy)).length()
    }

    /// Words of the lens in a camera block: those in place of the Jacobian's limits, and those behind the members
    /// (glsl/include/lens_members.glsl). None for pinholes and parallel rays.
    pub fn lens_words(&self) -> Option<([f32; 4], [f32; 9])> {
        let (family, c) = self.lens()?;
        let fold = family.fold(&c);
        let word = |limit: f64| if limit.is_finite() { limit as f32 } else { 0.0 };
        let all = match family.surface {
            Surface::Sphere => [(PI / (2.0 * f64::from(self.whole().height))).sin(); 12],
            _ => (family.words)(&c),
        };
        let all = all.map(|word| word as f32);
        // Only fisheyes have more than nine coefficients. They have no other limits.
        let others = match family.surface {
            Surface::Plane => {
                let hold = family.hold(&c, self.corner(), fold);
                [word(hold), word(FAR * family.radius(&c, hold)), 0.0]
            }
            _ => [all[9], all[10], all[11]],
        };
        let mut words = [0.0; 9];
        words.copy_from_slice(&all[..9]);
        let [second, third, fourth] = others;
        Some(([word(fold), second, third, fourth], words))
    }

    /// Focal lengths and principal point, then the coefficients.
    pub(crate) fn lens_parameters(&self) -> [f32; LENS_PARAMETERS] {
        let mut all = [0.0; LENS_PARAMETERS];
        all[..4].copy_from_slice(&[self.fx, self.fy, self.cx, self.cy]);
        all[4..].copy_from_slice(&self.coefficients);
        all
    }

    /// Returns the camera with these focal lengths, principal point and coefficients.
    #[must_use]
    pub(crate) fn with_lens_parameters(self, parameters: &[f32; LENS_PARAMETERS]) -> Self {
        let [fx, fy, cx, cy, coefficients @ ..] = *parameters;
        Self { fx, fy, cx, cy, coefficients, ..self }
    }

    /// Converts a gradient of the lens as [`LensGradient`](crate::passes::lens::LensGradient) writes it: it then is that of the focal
    /// lengths and the principal point (fx, fy, cx, cy, pixels), then of the coefficients.
    pub fn lens_gradient(&self, of_words: &[f32; LENS_PARAMETERS]) -> [f64; LENS_PARAMETERS] {
        /// Difference of coefficients by which the words are differentiated.
        const STEP: f64 = 1e-5;
        let mut gradient = of_words.map(f64::from);
        let Some((family, c)) = self.lens() else { return gradient };
        for (place, gradient) in gradient[4..].iter_mut().enumerate() {
            let [low, high] = [-STEP, STEP].map(|step| {
                let mut moved = c;
                moved[place] += step;
                (family.words)(&moved)
            });
            *gradient = (0..12).map(|k| f64::from(of_words[4 + k]) * (high[k] - low[k]) / (2.0 * STEP)).sum();
        }
        gradient
    }

    /// Units of refinement: the change of each [lens parameter](Self::lens_parameters) with each of sixteen numbers. A number of 1
    /// moves the picture's points by a focal length (root of the mean square). Two numbers move them in uncorrelated ways, because Adam
    /// cannot tell parameters apart that act alike (Park et al. 2023, "CamP"). Focal lengths that are nearly equal keep their ratio.
    /// Coefficients that the family seldom has stay 0.
    pub(crate) fn lens_units(&self) -> [[f64; LENS_PARAMETERS]; LENS_PARAMETERS] {
        /// Points on each side of the picture at which motions are compared.
        const GRID: u32 = 12;
        /// Share by which motions are taken as less alike than they are, so that no unit changes a parameter without bounds.
        const DAMPING: f64 = 0.01;
        const STEP: f64 = 1e-5;
        /// Largest relative difference of focal lengths that keep their ratio.
        const TIED: f32 = 0.01;
        let mut units = [[0.0; LENS_PARAMETERS]; LENS_PARAMETERS];
        let Some((family, c)) = self.lens().filter(|(family, _)| family.surface != Surface::Sphere) else {
            return units;
        };
        // Pictures whose sides were rounded have focal lengths that differ a little.
        let is_tied = (self.fx - self.fy).abs() < TIED * self.fx;
        let is_learned = |k: &usize| match *k {
            1 => !is_tied,
            0..4 => true,
            k => family.learned.contains(&(k - 4)) || c[k - 4] != 0.0,
        };
        let learned: Vec<usize> = (0..LENS_PARAMETERS).filter(is_learned).collect();
        let lens = self.whole().photo_lens();
        let rays = lens.rays();
        let motion_of = |place: DVec2, parameter: usize| -> DVec2 {
            let focal = lens.focal_px.x;
            match parameter {
                0 | 1 => {
                    let axis = [dvec2(1.0, 0.0), dvec2(0.0, 1.0)][parameter];
                    let both = if is_tied { DVec2::ONE } else { axis };
                    both * (lens.position_of(place) - lens.center_px) / lens.focal_px / focal
                }
                2 => DVec2::X / focal,
                3 => DVec2::Y / focal,
                _ => {
                    let mut moved = lens;
                    moved.coefficients[parameter - 4] += STEP;
                    (moved.position_of(place) - lens.position_of(place)) / (STEP * focal)
                }
            }
        };
        let n = learned.len();
        let (mut likeness, mut points) = (vec![vec![0.0; n]; n], 0.0);
        for index in 0..GRID * GRID {
            let share = (dvec2((index % GRID).into(), (index / GRID).into()) + 0.5) / f64::from(GRID);
            let position = share * dvec2(lens.width.into(), lens.height.into());
            let Some(place) = rays(position).and_then(|ray| lens.place(ray)) else { continue };
            let motions: Vec<DVec2> = learned.iter().map(|&k| motion_of(place, k)).collect();
            points += 1.0;
            for (a, row) in motions.iter().zip(&mut likeness) {
                motions.iter().zip(row).for_each(|(b, sum)| *sum += a.dot(*b));
            }
        }
        // Cholesky's factor L of the damped mean, L Lᵀ; the units are the columns of the inverse of Lᵀ.
        let mut factor = vec![vec![0.0; n]; n];
        for i in 0..n {
            for j in 0..=i {
                let damping = if i == j { 1.0 + DAMPING } else { 1.0 };
                let rest = likeness[i][j] * damping / f64::max(points, 1.0)
                    - (0..j).map(|k| factor[i][k] * factor[j][k]).sum::<f64>();
                factor[i][j] = if i == j { rest.max(1e-24).sqrt() } else { rest / factor[j][j] };
            }
        }
        for (column, &unit) in learned.iter().enumerate() {
            let mut x = vec![0.0; n];
            for i in (0..=column).rev() {
                let rest: f64 = (i + 1..=column).map(|k| factor[k][i] * x[k]).sum();
                x[i] = (f64::from(u8::from(i == column)) - rest) / factor[i][i];
                units[learned[i]][unit] = x[i];
            }
        }
        if is_tied {
            units[1] = units[0].map(|unit| unit * f64::from(self.fy / self.fx));
        }
        units
    }

    /// True if directions reach the whole picture, or of a fisheye, whose corners may be black, the middles of its sides.
    fn shows_its_picture(&self, whole: &Camera) -> bool {
        let rays = whole.photo_lens().rays();
        let [w, h] = [whole.width, whole.height].map(f64::from);
        let [cx, cy] = [whole.cx, whole.cy].map(f64::from);
        let middles = [[0.0, cy], [w, cy], [cx, 0.0], [cx, h]];
        let corners = [[0.0, 0.0], [w, 0.0], [0.0, h], [w, h]];
        let is_plane = whole.projection.surface() == Some(Surface::Plane);
        // A circular fisheye may lie within the picture: then directions reach beyond a quarter turn.
        let shown = |place: [f64; 2]| rays(place.into()).is_some();
        match is_plane {
            true => middles.into_iter().chain(corners).all(shown),
            false => middles.into_iter().all(shown) || self.photo_lens().widest() > FRAC_PI_2,
        }
    }

    /// Describes what is wrong with the lens, if anything.
    pub(super) fn lens_problem(&self) -> Option<String> {
        let used = self.projection.family().map_or(0, |family| family.coefficients);
        if !self.coefficients.iter().all(|c| c.is_finite())
            || self.coefficients[used..].iter().any(|&c| c != 0.0)
        {
            let (name, own) = (self.projection.name(), self.coefficients);
            return Some(format!("coefficients {own:?}: {name} has {used} that are finite, then zeros"));
        }
        let (family, _) = self.lens()?;
        let whole = self.whole();
        match family.surface {
            Surface::Sphere => {
                let (w, h) = (whole.width, whole.height);
                let around = PhotoLens::panorama(w, h).intrinsics();
                let differs = |own: f32, full: f32| (own - full).abs() > 1e-4 * full;
                // Scaled photographs may have rounded sides.
                if w.abs_diff(2 * h) > 1 {
                    Some(format!("panorama of {w}x{h} is not 2:1"))
                } else if differs(self.fx, around.fx) || differs(self.fy, around.fy) {
                    let (fx, fy) = (self.fx, self.fy);
                    Some(format!("panorama of {w}x{h} with the focal lengths {fx}, {fy} is not all around"))
                } else {
                    None
                }
            }
            _ => {
                let last = self.coefficients.iter().rposition(|&c| c != 0.0).map_or(0, |last| last + 1);
                let distortion = &self.coefficients[..last];
                (!self.shows_its_picture(&whole)).then(|| {
                    format!("distortion {distortion:?} folds the picture within the image, or shows none")
                })
            }
        }
    }
}

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
        // Most points are far outside: looking for folds is expensive.
        let is_shown = |place| self.contains(self.position_of(place)) && self.is_sound_up_to(place);
        self.place(at).is_some_and(is_shown)
    }

    /// True for a position within the picture.
    fn contains(&self, position: DVec2) -> bool {
        let size = dvec2(self.width.into(), self.height.into());
        position.cmpge(DVec2::ZERO).all() && position.cmplt(size).all()
    }

    /// Gives the index of the pixel that shows a point in camera space, by rows. None if the picture does not show it. Looks for the
    /// lens's fold only once.
    pub fn pixels(&self) -> impl Fn(DVec3) -> Option<usize> + use<> {
        let lens = *self;
        let widest = if self.projection.has_seam() { f64::INFINITY } else { self.widest() };
        move |at| {
            let place = lens.place(at).filter(|place| place.length() < widest)?;
            let position = lens.position_of(place);
            lens.contains(position).then(|| position.y as usize * lens.width as usize + position.x as usize)
        }
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
