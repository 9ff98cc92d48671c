//! The gradient of L = (1 − λ)·mean|x − y| + λ·(1 − mean SSIM) with respect to the picture x, the twin of
//! `loss/ssim_backward`.

use super::ssim_forward::{Plane, SsimPlane, blur};

/// dL/dx of one channel; `values` is the number of values in all the channels together.
pub fn ssim_backward(
    x: &Plane,
    y: &Plane,
    forward: &SsimPlane,
    lambda_dssim: f64,
    values: usize,
) -> Vec<f64> {
    let spread = |values: &Vec<f64>| {
        // The window is symmetric, so its transpose is itself.
        blur(&Plane { width: x.width, height: x.height, values: values.clone() })
    };
    let (mean, square, product) =
        (spread(&forward.d_mean), spread(&forward.d_square), spread(&forward.d_product));
    (0..x.values.len())
        .map(|i| {
            let difference = x.values[i] - y.values[i];
            let sign = if difference == 0.0 { 0.0 } else { difference.signum() };
            let d_ssim = mean[i] + 2.0 * x.values[i] * square[i] + y.values[i] * product[i];
            ((1.0 - lambda_dssim) * sign - lambda_dssim * d_ssim) / values as f64
        })
        .collect()
}
