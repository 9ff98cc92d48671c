//! Mip-Splatting's 3D filter; the twin of `forward/filter_sizes` and of the filter in the projection.

use super::linear::sigmoid;
use super::types::{Gaussian, Gradient};

/// Standard deviations from the depths of `nearest_depths`, world units; `longest_focal_px` is the longest of all
/// cameras.
pub fn filter_sizes(nearest: &[Option<f64>], longest_focal_px: f64) -> Vec<f64> {
    let farthest = nearest.iter().flatten().copied().fold(0.0, f64::max);
    nearest.iter().map(|depth| 0.2_f64.sqrt() * depth.unwrap_or(farthest) / longest_focal_px).collect()
}

/// The Gaussian as drawn: convolved with the filter, with less opacity by the growth of its scales. A size of 0
/// changes nothing.
pub fn filtered(gaussian: &Gaussian, size: f64) -> Gaussian {
    if size == 0.0 {
        return gaussian.clone();
    }
    let scale = gaussian.log_scale.map(f64::exp);
    let wide = scale.map(|s| s.hypot(size));
    let opacity = sigmoid(gaussian.opacity_logit) * shrink(gaussian, size);
    Gaussian {
        log_scale: wide.map(f64::ln),
        opacity_logit: (opacity / (1.0 - opacity)).ln(),
        ..gaussian.clone()
    }
}

pub fn shrink(gaussian: &Gaussian, size: f64) -> f64 {
    gaussian.log_scale.map(f64::exp).map(|s| s / s.hypot(size)).into_iter().product()
}

/// Converts the gradient of the drawn Gaussian to the stored one; `d_opacity` is that of the drawn opacity.
pub fn filtered_backward(gaussian: &Gaussian, size: f64, d_opacity: f64, gradient: &mut Gradient) {
    if size == 0.0 {
        return;
    }
    let (stored, shrink) = (sigmoid(gaussian.opacity_logit), shrink(gaussian, size));
    for (axis, log_scale) in gaussian.log_scale.iter().enumerate() {
        let (variance, filter) = ((2.0 * log_scale).exp(), size * size);
        let d = gradient.log_scale[axis];
        gradient.log_scale[axis] =
            (d * variance + d_opacity * stored * shrink * filter) / (variance + filter);
    }
    gradient.opacity_logit = d_opacity * shrink * stored * (1.0 - stored);
}
