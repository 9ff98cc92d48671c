//! Learning rates and weights over the iterations.

/// Log-linear interpolation from `first` to `last` over `steps`.
pub fn log_linear(step: f64, first: f64, last: f64, steps: f64) -> f64 {
    let t = (step / steps).clamp(0.0, 1.0);
    (first.ln() * (1.0 - t) + last.ln() * t).exp()
}

/// Rate of the positions.
pub fn position_rate(step: f64, scene_extent: f64) -> f64 {
    log_linear(step, 1.6e-4 * scene_extent, 1.6e-6 * scene_extent, 30_000.0)
}

/// Rate of the per-image exposure.
pub fn exposure_rate(step: f64) -> f64 {
    log_linear(step, 0.01, 0.001, 30_000.0)
}

/// Weight of the inverse-depth regularisation.
pub fn depth_weight(step: f64) -> f64 {
    log_linear(step, 1.0, 0.01, 30_000.0)
}
