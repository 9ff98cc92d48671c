//! Real spherical harmonics up to degree 3, with the signs of the reference implementation.
//!
//! Coefficient `l² + l + m` belongs to degree l, order m; the direction points from the camera to the Gaussian.

use super::gaussians::sh_coefficients;
use super::sh;
use glam::DMat3;

/// Y₀₀, the factor of the constant term.
pub const C0: f64 = 0.28209479177387814;
/// Factor of the linear terms.
pub const C1: f64 = 0.4886025119029199;
/// Factors of the quadratic terms.
pub const C2: [f64; 5] =
    [1.0925484305920792, -1.0925484305920792, 0.31539156525252005, -1.0925484305920792, 0.5462742152960396];
/// Factors of the cubic terms.
pub const C3: [f64; 7] = [
    -0.5900435899266435,
    2.890611442640554,
    -0.4570457994644658,
    0.3731763325901154,
    -0.4570457994644658,
    1.445305721320277,
    -0.5900435899266435,
];

/// Constant SH coefficient of a colour channel in [0, 1]: `(rgb − 0.5) / Y₀₀`.
pub fn rgb_to_sh_dc(rgb: f32) -> f32 {
    ((f64::from(rgb) - 0.5) / C0) as f32
}

/// Colour channel of a constant SH coefficient; inverse of [`rgb_to_sh_dc`].
pub fn sh_dc_to_rgb(sh_dc: f32) -> f32 {
    (f64::from(sh_dc) * C0 + 0.5) as f32
}

/// All 16 basis functions at a direction of unit length.
pub fn basis([x, y, z]: [f64; 3]) -> [f64; 16] {
    let (xx, yy, zz) = (x * x, y * y, z * z);
    [
        C0,
        -C1 * y,
        C1 * z,
        -C1 * x,
        C2[0] * x * y,
        C2[1] * y * z,
        C2[2] * (2.0 * zz - xx - yy),
        C2[3] * x * z,
        C2[4] * (xx - yy),
        C3[0] * y * (3.0 * xx - yy),
        C3[1] * x * y * z,
        C3[2] * y * (4.0 * zz - xx - yy),
        C3[3] * z * (2.0 * zz - 3.0 * xx - 3.0 * yy),
        C3[4] * x * (4.0 * zz - xx - yy),
        C3[5] * z * (xx - yy),
        C3[6] * x * (xx - 3.0 * yy),
    ]
}

/// Colour from a direction: `max(0, 0.5 + Σ Y·sh)`, with the coefficients up to `degree`.
///
/// `sh` holds at least `sh_coefficients(degree)` coefficients (r, g, b); `direction` has unit length and points
/// from the camera to the Gaussian.
pub fn color(sh: &[[f32; 3]], degree: u32, direction: [f32; 3]) -> [f32; 3] {
    let basis = basis(direction.map(f64::from));
    std::array::from_fn(|channel| {
        let terms = sh[..sh_coefficients(degree)].iter().zip(basis);
        let sum: f64 = terms.map(|(coefficient, y)| f64::from(coefficient[channel]) * y).sum();
        (0.5 + sum).max(0.0) as f32
    })
}

/// Number of orders of degree 3.
const WIDEST: usize = 7;

/// A matrix for the orders -l..=l of one degree, in the upper left corner.
type Band = [[f64; WIDEST]; WIDEST];

/// Rotation of SH coefficients.
#[derive(Clone, Debug, PartialEq)]
pub struct ShRotation {
    /// Matrices of degrees 1, 2 and 3.
    bands: [Band; 3],
}

impl ShRotation {
    /// Creates the matrices for `rotation` (orthonormal, determinant 1), which maps old directions to new ones.
    ///
    /// After Ivanic and Ruedenberg, "Rotation Matrices for Real Spherical Harmonics", J. Phys. Chem. 1996, with the correction
    /// of 1998: each matrix follows from those of degree 1 and of the previous degree. Their functions have no Condon-Shortley
    /// phase, but those of [`sh::basis`] do, so elements between an even and an odd order change sign.
    pub fn new(rotation: DMat3) -> Self {
        // Orders -1, 0, 1 are y, z, x.
        const AXIS: [usize; 3] = [1, 2, 0];
        let mut first = [[0.0; WIDEST]; WIDEST];
        for (row, &to) in AXIS.iter().enumerate() {
            for (column, &from) in AXIS.iter().enumerate() {
                first[row][column] = rotation.col(from)[to];
            }
        }
        let second = next_band(2, &first, &first);
        let third = next_band(3, &first, &second);
        Self { bands: [with_phase(first, 1), with_phase(second, 2), with_phase(third, 3)] }
    }

    /// Rotates the coefficients of one Gaussian, `sh_coefficients(degree)` of them for any degree up to 3.
    pub fn apply(&self, sh: &mut [[f32; 3]]) {
        for (band, l) in self.bands.iter().zip(1..) {
            let (start, end) = (sh_coefficients(l - 1), sh_coefficients(l));
            if sh.len() < end {
                return;
            }
            let mut old = [[0.0; 3]; WIDEST];
            for (old, new) in old.iter_mut().zip(&sh[start..end]) {
                *old = new.map(f64::from);
            }
            for (new, row) in sh[start..end].iter_mut().zip(band) {
                for (channel, value) in new.iter_mut().enumerate() {
                    *value =
                        row.iter().zip(&old).map(|(factor, old)| factor * old[channel]).sum::<f64>() as f32;
                }
            }
        }
    }
}

/// Sign that each of the 16 basis functions receives when axes are mirrored (`signs` are 1 or -1).
pub fn mirror_signs(signs: [f64; 3]) -> [f32; 16] {
    // Each function is even or odd in each axis; no function is 0 in this direction.
    let direction = [0.36, 0.48, 0.8];
    let mirrored = std::array::from_fn(|axis| signs[axis] * direction[axis]);
    let (before, after) = (sh::basis(direction), sh::basis(mirrored));
    std::array::from_fn(|k| (after[k] / before[k]).signum() as f32)
}

fn with_phase(mut band: Band, l: usize) -> Band {
    for (row, values) in band.iter_mut().enumerate().take(2 * l + 1) {
        for (column, value) in values.iter_mut().enumerate().take(2 * l + 1) {
            if (row + column) % 2 == 1 {
                *value = -*value;
            }
        }
    }
    band
}

/// Computes the matrix of degree `l` from those of degree 1 and `l - 1`.
fn next_band(l: i32, first: &Band, previous: &Band) -> Band {
    let recursion = Recursion { l, first, previous };
    let mut band = [[0.0; WIDEST]; WIDEST];
    for m in -l..=l {
        for n in -l..=l {
            band[(m + l) as usize][(n + l) as usize] = recursion.element(m, n);
        }
    }
    band
}

/// Tables 1 and 2 of the paper.
struct Recursion<'a> {
    l: i32,
    first: &'a Band,
    previous: &'a Band,
}

impl Recursion<'_> {
    fn element(&self, m: i32, n: i32) -> f64 {
        let l = self.l;
        let denominator = f64::from(if n.abs() < l { (l + n) * (l - n) } else { 2 * l * (2 * l - 1) });
        let root = |product: i32| (f64::from(product) / denominator).sqrt();
        let zero = m == 0;
        let u = root((l + m) * (l - m));
        let v = 0.5 * root((if zero { 2 } else { 1 }) * (l + m.abs() - 1) * (l + m.abs()));
        let v = if zero { -v } else { v };
        let w = if zero { 0.0 } else { -0.5 * root((l - m.abs() - 1) * (l - m.abs())) };
        // Terms with a factor of 0 lie outside the matrices and must not be evaluated.
        let term = |factor: f64, value: &dyn Fn() -> f64| if factor == 0.0 { 0.0 } else { factor * value() };
        term(u, &|| self.p(0, m, n)) + term(v, &|| self.v(m, n)) + term(w, &|| self.w(m, n))
    }

    fn v(&self, m: i32, n: i32) -> f64 {
        let root_of_two = std::f64::consts::SQRT_2;
        match m {
            0 => self.p(1, 1, n) + self.p(-1, -1, n),
            1 => self.p(1, 0, n) * root_of_two,
            -1 => self.p(-1, 0, n) * root_of_two,
            2.. => self.p(1, m - 1, n) - self.p(-1, 1 - m, n),
            _ => self.p(1, m + 1, n) + self.p(-1, -m - 1, n),
        }
    }

    fn w(&self, m: i32, n: i32) -> f64 {
        if m > 0 {
            self.p(1, m + 1, n) + self.p(-1, -m - 1, n)
        } else {
            self.p(1, m - 1, n) - self.p(-1, 1 - m, n)
        }
    }

    fn p(&self, i: i32, a: i32, b: i32) -> f64 {
        let l = self.l;
        let first = |n: i32| self.first[(i + 1) as usize][(n + 1) as usize];
        let previous = |n: i32| self.previous[(a + l - 1) as usize][(n + l - 1) as usize];
        if b == l {
            first(1) * previous(l - 1) - first(-1) * previous(1 - l)
        } else if b == -l {
            first(1) * previous(1 - l) + first(-1) * previous(l - 1)
        } else {
            first(0) * previous(b)
        }
    }
}
