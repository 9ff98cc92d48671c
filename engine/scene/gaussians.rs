//! The Gaussians of a scene, as raw (unactivated) parameters.

use glam::{DVec3, Vec3};

use super::points::Bounds;
use super::strays::median_ball;
use crate::error::{Error, Result};

/// Highest supported degree of the spherical harmonics.
pub const MAX_SH_DEGREE: u32 = 3;

/// Number of SH coefficients per colour channel at a degree: `(degree + 1)²`.
pub const fn sh_coefficients(degree: u32) -> usize {
    ((degree + 1) * (degree + 1)) as usize
}

/// A set of Gaussians, structure of arrays, with raw parameters as in a PLY and in the optimiser.
///
/// All vectors have `len()` entries, `sh` has `len() * sh_coefficients(sh_degree)`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Gaussians {
    /// Degree of the stored spherical harmonics, 0 to 3.
    pub sh_degree: u32,
    /// Means, world units.
    pub means: Vec<[f32; 3]>,
    /// Rotations as quaternions (w, x, y, z), not necessarily of unit length.
    pub quats: Vec<[f32; 4]>,
    /// Natural logarithms of the standard deviations along the Gaussian's own axes, world units.
    pub log_scales: Vec<[f32; 3]>,
    /// Opacity before the sigmoid.
    pub opacity_logits: Vec<f32>,
    /// SH coefficients, `[Gaussian][coefficient]`, each (r, g, b).
    pub sh: Vec<[f32; 3]>,
}

impl Gaussians {
    /// An empty set with an SH degree, and memory reserved for `count` Gaussians.
    pub fn with_capacity(sh_degree: u32, count: usize) -> Self {
        Self {
            sh_degree,
            means: Vec::with_capacity(count),
            quats: Vec::with_capacity(count),
            log_scales: Vec::with_capacity(count),
            opacity_logits: Vec::with_capacity(count),
            sh: Vec::with_capacity(count * sh_coefficients(sh_degree)),
        }
    }

    /// Number of Gaussians.
    pub fn len(&self) -> usize {
        self.means.len()
    }

    /// True if there are no Gaussians.
    pub fn is_empty(&self) -> bool {
        self.means.is_empty()
    }

    /// SH coefficients of one Gaussian, `sh_coefficients(sh_degree)` of them.
    pub fn sh_of(&self, index: usize) -> &[[f32; 3]] {
        let k = sh_coefficients(self.sh_degree);
        &self.sh[index * k..(index + 1) * k]
    }

    /// Refuses vectors of the wrong length, and a degree above 3.
    pub fn check_shapes(&self) -> Result<()> {
        if self.sh_degree > MAX_SH_DEGREE {
            return Err(Error::argument("sh_degree", format!("{} is not between 0 and 3", self.sh_degree)));
        }
        let n = self.len();
        let shapes = [
            ("quats", self.quats.len(), n),
            ("log_scales", self.log_scales.len(), n),
            ("opacity_logits", self.opacity_logits.len(), n),
            ("sh", self.sh.len(), n * sh_coefficients(self.sh_degree)),
        ];
        match shapes.iter().find(|(_, has, needs)| has != needs) {
            None => Ok(()),
            Some((name, has, needs)) => {
                Err(Error::argument(*name, format!("{has} entries, {n} Gaussians need {needs}")))
            }
        }
    }

    /// Returns the same Gaussians at another SH degree: higher coefficients are dropped, or added as 0.
    pub fn with_sh_degree(&self, sh_degree: u32) -> Self {
        let k = sh_coefficients(sh_degree.min(MAX_SH_DEGREE));
        let mut sh = Vec::with_capacity(self.len() * k);
        for index in 0..self.len() {
            let stored = self.sh_of(index);
            let kept = k.min(stored.len());
            sh.extend_from_slice(&stored[..kept]);
            sh.resize(sh.len() + k - kept, [0.0; 3]);
        }
        Self { sh_degree: sh_degree.min(MAX_SH_DEGREE), sh, ..self.clone() }
    }

    /// Statistics of positions, scales and opacities, for `info`.
    pub fn statistics(&self) -> GaussianStatistics {
        let means = || self.means.iter().map(|&p| Vec3::from_array(p)).filter(|p| p.is_finite());
        let scales = || self.log_scales.iter().flatten().map(|s| s.exp());
        let opacities = || self.opacity_logits.iter().map(|o| 1.0 / (1.0 + (-o).exp()));
        GaussianStatistics {
            count: self.len(),
            sh_degree: self.sh_degree,
            bounds: Bounds::of(means()),
            central_bounds: central_bounds(means()),
            scale_percentiles: percentiles(scales()),
            opacity_percentiles: percentiles(opacities()),
            density_percentiles: percentiles((0..self.len()).map(|index| self.log_density(index).exp())),
        }
    }
}

/// Summary of a set of Gaussians.
#[derive(Clone, Debug, PartialEq)]
pub struct GaussianStatistics {
    /// Number of Gaussians.
    pub count: usize,
    /// Degree of the stored spherical harmonics.
    pub sh_degree: u32,
    /// Box around all means; `None` without Gaussians.
    pub bounds: Option<Bounds>,
    /// Box from the 5th to the 95th percentile of the means on each axis, without floaters. If it is far larger than the middle
    /// half of the means, distant means are excluded.
    pub central_bounds: Option<Bounds>,
    /// Standard deviations (all three axes) at 0, 5, 25, 50, 75, 95 and 100 %, world units.
    pub scale_percentiles: Option<[f32; 7]>,
    /// Opacities (after the sigmoid) at 0, 5, 25, 50, 75, 95 and 100 %.
    pub opacity_percentiles: Option<[f32; 7]>,
    /// Densities ([`Gaussians::log_density`]) at 0, 5, 25, 50, 75, 95 and 100 %, per world unit.
    pub density_percentiles: Option<[f32; 7]>,
}

/// The values at 0, 5, 25, 50, 75, 95 and 100 % (nearest rank); `None` without values.
pub fn percentiles(values: impl Iterator<Item = f32>) -> Option<[f32; 7]> {
    let mut sorted: Vec<f32> = values.collect();
    sorted.sort_unstable_by(f32::total_cmp);
    let last = sorted.len().checked_sub(1)?;
    Some([0, 5, 25, 50, 75, 95, 100].map(|percent| sorted[(last * percent + 50) / 100]))
}

/// Largest half diagonal of the central box, and largest distance of the means in a larger one, in median distances from the
/// median. Ordinary scenes stay below 3.
const CENTRAL_REACH: f64 = 8.0;

fn central_bounds(means: impl Iterator<Item = Vec3> + Clone) -> Option<Bounds> {
    let bounds = nine_tenths(means.clone())?;
    let points: Vec<DVec3> = means.clone().map(|mean| mean.as_dvec3()).collect();
    let Some((center, radius)) = median_ball(&points) else { return Some(bounds) };
    let reach = CENTRAL_REACH * radius;
    match 0.5 * bounds.size().as_dvec3().length() > reach {
        true => nine_tenths(means.filter(|mean| mean.as_dvec3().distance(center) <= reach)),
        false => Some(bounds),
    }
}

fn nine_tenths(means: impl Iterator<Item = Vec3> + Clone) -> Option<Bounds> {
    let axis = |axis: usize| percentiles(means.clone().map(|p| p[axis]));
    let (x, y, z) = (axis(0)?, axis(1)?, axis(2)?);
    let at = |rank: usize| Vec3::new(x[rank], y[rank], z[rank]);
    Some(Bounds { min: at(1), max: at(5) })
}
