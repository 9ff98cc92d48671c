//! opacity ← min(opacity, 0.01), moments zeroed by the caller; the twin of `densify/reset_opacity`.

use super::linear::sigmoid;

/// The new logit. `shrink` is the 3D filter's factor of the drawn opacity, 1 without a filter.
pub fn reset_opacity(logit: f64, shrink: f64) -> f64 {
    let drawn = sigmoid(logit) * shrink;
    let opacity = drawn.min(0.01_f32.into()) / shrink;
    (opacity / (1.0 - opacity)).ln()
}
