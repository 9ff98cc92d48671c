//! Learning rates and weights over the iterations.

/// Log-linear interpolation from `first` to `last` over `steps`.
pub fn log_linear(step: f64, first: f64, last: f64, steps: f64) -> f64 {
    let t = (step / steps).clamp(0.0, 1.0);
    (first.ln() * (1.0 - t) + last.ln() * t).exp()
}

pub fn position_rate(step: f64, scene_extent: f64) -> f64 {
    log_linear(step, 1.6e-4 * scene_extent, 1.6e-6 * scene_extent, 30_000.0)
}

/// The quantile with linear interpolation between ranks.
pub fn quantile(values: &[f64], share: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let place = share * (sorted.len() - 1) as f64;
    let (low, high) = (sorted[place.floor() as usize], sorted[place.ceil() as usize]);
    low + place.fract() * (high - low)
}
