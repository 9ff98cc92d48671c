//! Real spherical harmonics up to degree 3, with the signs of the reference implementation.
//!
//! Coefficient `l² + l + m` belongs to degree l, order m; the direction points from the camera to the Gaussian.

use super::gaussians::sh_coefficients;

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
