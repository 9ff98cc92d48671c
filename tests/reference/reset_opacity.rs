//! opacity ← min(opacity, 0.01), moments zeroed by the caller; the twin of `densify/reset_opacity`.

use super::linear::sigmoid;

/// The new logit; `shrink` is the factor of the opacity that a 3D filter draws, 1 without one.
pub fn reset_opacity(logit: f64, shrink: f64) -> f64 {
    let drawn = sigmoid(logit) * shrink;
    let opacity = drawn.min(0.01_f32.into()) / shrink;
    (opacity / (1.0 - opacity)).ln()
}
