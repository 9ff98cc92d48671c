//! The loss as one number.

use super::ssim::{Plane, ssim_backward, ssim_forward};

/// Weight of 1 − SSIM in the loss.
pub const LAMBDA_DSSIM: f64 = 0.2;

/// The loss, its two parts, the SSIM per value and the gradient; interleaved rgb.
pub struct Loss {
    /// (1 − λ)·l1 + λ·(1 − ssim).
    pub loss: f64,
    pub l1: f64,
    pub ssim: f64,
    /// SSIM per pixel and channel.
    pub ssim_map: Vec<f64>,
    pub gradient: Vec<f64>,
}

/// The loss of the picture `x` against `y`, both row-major interleaved rgb.
pub fn loss(x: &[f64], y: &[f64], width: usize, height: usize) -> Loss {
    let count = x.len();
    let mut result =
        Loss { loss: 0.0, l1: 0.0, ssim: 0.0, ssim_map: vec![0.0; count], gradient: vec![0.0; count] };
    for channel in 0..3 {
        let plane = |picture: &[f64]| Plane {
            width,
            height,
            values: picture.iter().skip(channel).step_by(3).copied().collect(),
        };
        let (a, b) = (plane(x), plane(y));
        let forward = ssim_forward(&a, &b);
        let gradient = ssim_backward(&a, &b, &forward, LAMBDA_DSSIM, count);
        for i in 0..width * height {
            result.ssim_map[3 * i + channel] = forward.ssim[i];
            result.gradient[3 * i + channel] = gradient[i];
            result.l1 += (a.values[i] - b.values[i]).abs();
            result.ssim += forward.ssim[i];
        }
    }
    result.l1 /= count as f64;
    result.ssim /= count as f64;
    result.loss = (1.0 - LAMBDA_DSSIM) * result.l1 + LAMBDA_DSSIM * (1.0 - result.ssim);
    result
}
