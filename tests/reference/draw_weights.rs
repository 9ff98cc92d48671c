//! Whole-number weights in proportion to opacity; the twin of `densify/draw_weights`.

use super::linear::sigmoid;

/// Weight of opacity 1, so that the sum of `count` weights fits 32 bits.
pub fn unit(count: usize) -> f64 {
    f64::from((u32::MAX / count.max(1) as u32).min(1 << 24))
}

/// Weight of a Gaussian with this logit; 0 for opacities up to `least`.
pub fn weight(logit: f64, unit: f64, least: f64) -> f64 {
    let opacity = sigmoid(logit);
    if opacity > least { (opacity * unit).floor().max(1.0) } else { 0.0 }
}
