//! opacity ← min(opacity, 0.01), moments zeroed by the caller; the twin of `densify/reset_opacity`.

use super::linear::sigmoid;

/// The new logit.
pub fn reset_opacity(logit: f64) -> f64 {
    let opacity = sigmoid(logit).min(0.01_f32.into());
    (opacity / (1.0 - opacity)).ln()
}
