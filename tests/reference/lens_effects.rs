//! Vignetting and response of a camera; the twin of `exposure/lens_effects`.

/// Rows per channel: three coefficients of vignetting, and the logarithm of the response's exponent.
pub type Rows = [[f64; 4]; 3];

/// Below this value the response is a straight line.
pub const LEAST: f64 = 1.0 / 1024.0;

/// Squared distances of the pixels from the principal point, row by row, in squares of half the diagonal. The first
/// pixel's centre is 0.
pub fn squares_of_radii([width, height]: [usize; 2], center_px: [f64; 2]) -> Vec<f64> {
    let half_diagonal = ((width * width + height * height) as f64).sqrt() / 2.0;
    let square = |pixel: usize| {
        let x = (pixel % width) as f64 - center_px[0];
        let y = (pixel / width) as f64 - center_px[1];
        (x.hypot(y) / half_diagonal).powi(2)
    };
    (0..width * height).map(square).collect()
}

pub fn vignetting(row: &[f64; 4], r2: f64) -> f64 {
    1.0 + row[0] * r2 + row[1] * r2.powi(2) + row[2] * r2.powi(3)
}

/// The response to `t`.
pub fn response(t: f64, log_gamma: f64) -> f64 {
    let gamma = log_gamma.exp();
    if t > LEAST { t.powf(gamma) } else { t / LEAST * LEAST.powf(gamma) }
}

pub fn lens_effects(picture: &[[f64; 3]], rows: &Rows, r2: &[f64]) -> Vec<[f64; 3]> {
    let of = |(color, &r2): (&[f64; 3], &f64)| {
        [0, 1, 2].map(|c| response(color[c] * vignetting(&rows[c], r2), rows[c][3]))
    };
    picture.iter().zip(r2).map(of).collect()
}

/// True near the end of the straight line: the response has a corner there, and float32 kernels may take either
/// side.
pub fn has_corner(color: &[f64; 3], rows: &Rows, r2: f64) -> bool {
    (0..3).any(|c| (color[c] * vignetting(&rows[c], r2) / LEAST - 1.0).abs() < 1e-4)
}
