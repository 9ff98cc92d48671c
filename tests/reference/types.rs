//! The twins' own types: double precision, arrays of structures, nothing shared with the engine.

use super::gather::pcg4d;

/// Which pixels a Gaussian may reach (spec: "Extent").
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Extent {
    /// Wherever power ≤ 0 and α ≥ 1/255.
    Exact,
    /// The square of three standard deviations of the reference implementation.
    Reference,
}

#[derive(Clone, Debug, PartialEq)]
pub struct Gaussian {
    pub mean: [f64; 3],
    /// (w, x, y, z), not normalised.
    pub quat: [f64; 4],
    /// Natural logarithm of the standard deviations.
    pub log_scale: [f64; 3],
    pub opacity_logit: f64,
    /// SH coefficients, coefficient-major, rgb last.
    pub sh: Vec<[f64; 3]>,
}

/// A camera and how to render with it.
#[derive(Clone, Debug)]
pub struct View {
    /// Row-major rotation, x_camera = R x_world + t.
    pub camera_from_world: [[f64; 3]; 3],
    pub translation: [f64; 3],
    pub focal_px: [f64; 2],
    /// cx, cy with pixel centres at +0.5.
    pub center_px: [f64; 2],
    pub size_px: [u32; 2],
    pub background: [f64; 3],
    pub sh_degree: u32,
    /// Opacity compensation for the dilation.
    pub antialias: bool,
    /// Gradients treat that compensation as constant.
    pub antialias_detached: bool,
    /// Standard deviation of the 3D filter of all Gaussians, world units; 0 for none.
    pub filter_3d: f64,
    /// Jacobian limits ±1.3 tan(fov/2), instead of the image edges plus 0.3 tan(fov/2).
    pub symmetric_limit: bool,
    pub extent: Extent,
    pub drawn: Style,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Style {
    /// Factor of the standard deviations.
    pub scale_modifier: f64,
    /// Added to both variances on the screen, px².
    pub dilation_px2: f64,
    /// If not 0, replaces all opacities (and the compensation). If negative, opacities below [`FAINT_OPACITY`]
    /// become 0 instead.
    pub opacity: f64,
    /// Limits that a drawn Gaussian must meet.
    pub cut: Limits,
    /// Random omission of Gaussians.
    pub dropout: Option<Dropout>,
    /// Factors of the scene. Only the culling and projecting kernels read them.
    pub tint: Option<Tint>,
    /// Volumes that keep or remove Gaussians. Only culling reads them.
    pub cut_outs: [Option<CutOut>; 3],
    /// Recoloured Gaussians. Only the projecting kernels read it.
    pub selection: Option<Selection>,
    /// Blends z, not 1/z, as the depth. Only the projecting kernels read it.
    pub z_record: bool,
    /// Splats have the order of distances.
    pub distance_order: bool,
    /// Parallel camera rays. Only the culling and projecting kernels read it.
    pub orthographic: bool,
}

/// Factors of a scene's colours and opacities.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tint {
    pub color: [f64; 3],
    /// Factor of the Gaussians' own opacities, 0 to 1.
    pub opacity: f64,
}

/// A volume that keeps or removes the Gaussians whose means lie inside, in float32.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CutOut {
    pub center: [f32; 3],
    /// Rows of the transform of relative positions to the volume's axes.
    pub rows: [[f32; 3]; 3],
    /// Half sizes of a box; the largest first coordinate of a half-space.
    pub bounds: [f32; 3],
    /// Box, unit ball or half-space: 0, 1, 2.
    pub shape: u32,
    /// True if the volume removes the Gaussians inside.
    pub removes: bool,
}

impl CutOut {
    pub fn contains(&self, mean: [f64; 3]) -> bool {
        let from = [0, 1, 2].map(|i| mean[i] as f32 - self.center[i]);
        let q = self.rows.map(|[a, b, c]| a * from[0] + b * from[1] + c * from[2]);
        match self.shape {
            0 => (0..3).all(|i| q[i].abs() <= self.bounds[i]),
            1 => q[0] * q[0] + q[1] * q[1] + q[2] * q[2] <= 1.0,
            _ => q[0] <= self.bounds[0],
        }
    }
}

/// Recolours about every other Gaussian.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Selection {
    pub color: [f64; 3],
    /// Share of that colour.
    pub share: f64,
}

impl Selection {
    pub fn selects(gaussian: usize) -> bool {
        pcg4d([gaussian as u32, 1, 2, 3])[0] & 1 == 1
    }
}

/// Random omission of Gaussians (DropGaussian): those whose 24-bit random number is less than `below`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dropout {
    /// Number out of 2^24.
    pub below: u32,
    /// Seed and iteration are the key of the random numbers.
    pub seed: u32,
    pub iteration: u32,
}

impl Dropout {
    pub fn drops(&self, gaussian: usize) -> bool {
        pcg4d([self.seed, self.iteration, gaussian as u32, 6])[0] >> 8 < self.below
    }

    /// Factor of the remaining opacities, rounded to float32.
    pub fn factor(&self) -> f64 {
        f64::from((1.0 / (1.0 - f64::from(self.below) / f64::from(1 << 24))) as f32)
    }
}

/// Conditions that a drawn Gaussian must meet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Least and largest coordinates of the mean.
    pub mean: [[f64; 3]; 2],
    /// Least opacity before the sigmoid.
    pub opacity_logit: f64,
    /// Least difference of the opacity logit and the largest log-scale, in float32.
    pub log_density: f64,
}

impl Limits {
    pub const NONE: Self = Self {
        mean: [[f32::MIN as f64; 3], [f32::MAX as f64; 3]],
        opacity_logit: f32::MIN as f64,
        log_density: f32::MIN as f64,
    };

    pub fn keep(&self, gaussian: &Gaussian) -> bool {
        let [low, high] = self.mean;
        let inside = (0..3).all(|i| (low[i]..=high[i]).contains(&gaussian.mean[i]));
        let largest = gaussian.log_scale.into_iter().fold(f64::NEG_INFINITY, f64::max);
        let log_density = f64::from(gaussian.opacity_logit as f32 - largest as f32);
        inside && gaussian.opacity_logit >= self.opacity_logit && log_density >= self.log_density
    }
}

impl Style {
    /// The projection as the kernels know it (PROJECTION_*).
    pub fn projection(&self) -> u32 {
        self.orthographic.into()
    }

    pub const AS_THEY_ARE: Self = Self {
        scale_modifier: 1.0,
        dilation_px2: DILATION,
        opacity: 0.0,
        cut: Limits::NONE,
        dropout: None,
        tint: None,
        cut_outs: [None; 3],
        selection: None,
        z_record: false,
        distance_order: false,
        orthographic: false,
    };

    pub fn keeps(&self, gaussian: &Gaussian) -> bool {
        let own = || self.cut_outs.iter().flatten();
        let inside = |removes: bool| own().any(|c| c.removes == removes && c.contains(gaussian.mean));
        !inside(true) && (inside(false) || own().all(|c| c.removes))
    }

    pub fn drops(&self, gaussian: usize) -> bool {
        self.dropout.is_some_and(|dropout| dropout.drops(gaussian))
    }

    /// A colour under the tint, at most the largest half float.
    pub fn tinted(&self, color: [f64; 3]) -> [f64; 3] {
        match self.tint {
            None => color,
            Some(tint) => [0, 1, 2].map(|i| (color[i] * tint.color[i]).min(65504.0)),
        }
    }

    /// The colour of a Gaussian, selected or not.
    pub fn highlighted(&self, gaussian: usize, color: [f64; 3]) -> [f64; 3] {
        match self.selection {
            Some(Selection { color: other, share }) if Selection::selects(gaussian) => {
                [0, 1, 2].map(|i| (1.0 - share) * color[i] + share * other[i])
            }
            _ => color,
        }
    }

    /// The scene's opacity factor of Gaussians; 1 if replaced opacities are drawn.
    pub fn fading(&self) -> f64 {
        self.tint.filter(|_| self.opacity == 0.0).map_or(1.0, |tint| tint.opacity)
    }

    /// Last factor of the opacities.
    pub fn opacity_factor(&self) -> f64 {
        self.dropout.map_or(1.0, |dropout| dropout.factor())
    }
}

/// Gaussians fainter than this are omitted if `Style::opacity` is negative.
pub const FAINT_OPACITY: f64 = 0.2_f32 as f64;

impl View {
    /// Columns and rows of the tile grid.
    pub fn tiles(&self) -> [u32; 2] {
        self.size_px.map(|n| n.div_ceil(TILE))
    }

    pub fn pixels(&self) -> usize {
        self.size_px[0] as usize * self.size_px[1] as usize
    }

    /// Returns the value that orders a splat: its z, or the distance of its mean.
    pub fn order_of(&self, splat: &Splat) -> f64 {
        if !self.drawn.distance_order || self.drawn.orthographic {
            return splat.depth;
        }
        let slope = |i: usize| (splat.mean2d_px[i] + 0.5 - self.center_px[i]) / self.focal_px[i];
        splat.depth * (1.0 + slope(0).powi(2) + slope(1).powi(2)).sqrt()
    }
}

/// A Gaussian projected onto the image.
#[derive(Clone, Debug, PartialEq)]
pub struct Splat {
    /// View depth z.
    pub depth: f64,
    /// Pixel centres at the integers.
    pub mean2d_px: [f64; 2],
    /// 2-D covariance (xx, xy, yy) after the dilation.
    pub cov2d: [f64; 3],
    /// Its inverse (A, B, C).
    pub conic: [f64; 3],
    /// Opacity after compensation.
    pub opacity: f64,
    /// Colour from SH, clamped at 0.
    pub color: [f64; 3],
    /// Radius of the reference implementation's square; 0 in the exact mode.
    pub radius_px: i32,
}

/// Gradient with respect to what the blending reads of a splat.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SplatGradient {
    pub mean2d_px: [f64; 2],
    pub conic: [f64; 3],
    /// dL/d(opacity after compensation).
    pub opacity: f64,
    pub color: [f64; 3],
    /// dL/d(1/z) through the inverse-depth image.
    pub inverse_depth: f64,
    /// Sum over pixels of |dL/d(centre in pixels)| through each pixel alone.
    pub absolute_px: [f64; 2],
}

/// Gradient with respect to a Gaussian's raw parameters.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Gradient {
    pub mean: [f64; 3],
    pub quat: [f64; 4],
    pub log_scale: [f64; 3],
    pub opacity_logit: f64,
    /// As many as stored.
    pub sh: Vec<[f64; 3]>,
}

/// Side of a tile.
pub const TILE: u32 = 16;
/// Near plane. All thresholds are constants rounded to float32.
pub const NEAR: f64 = 0.2_f32 as f64;
/// Added to the diagonal of the 2-D covariance.
pub const DILATION: f64 = 0.3_f32 as f64;
/// α's upper clamp.
pub const ALPHA_MAX: f64 = 0.99_f32 as f64;
/// α's lower threshold.
pub const ALPHA_MIN: f64 = (1.0_f32 / 255.0_f32) as f64;
/// Blending stops before the transmittance falls below this.
pub const TRANSMITTANCE_MIN: f64 = 1e-4_f32 as f64;
