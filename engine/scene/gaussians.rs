//! The Gaussians of a scene, as raw (unactivated) parameters.

/// Highest supported degree of the spherical harmonics.
pub const MAX_SH_DEGREE: u32 = 3;

/// Number of SH coefficients per colour channel at a degree: `(degree + 1)²`.
pub const fn sh_coefficients(degree: u32) -> usize {
    ((degree + 1) * (degree + 1)) as usize
}

/// A set of Gaussians, structure of arrays, raw parameters as they are stored in a PLY and optimised.
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
    /// Number of Gaussians.
    pub fn len(&self) -> usize {
        self.means.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.means.is_empty()
    }

    /// SH coefficients of one Gaussian, `sh_coefficients(sh_degree)` of them.
    pub fn sh_of(&self, index: usize) -> &[[f32; 3]] {
        let k = sh_coefficients(self.sh_degree);
        &self.sh[index * k..(index + 1) * k]
    }
}
