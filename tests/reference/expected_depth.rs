//! The expected depth of a pixel, the twin of `compose/expected_depth`.

/// sum(w z) / sum(w), or `empty` if the weights sum to less than `min_weight`.
pub fn expected_depth(transmittance: f32, depth_sum: f32, min_weight: f64, empty: f64) -> f64 {
    let weight = 1.0 - f64::from(transmittance);
    if weight >= min_weight && weight > 0.0 { f64::from(depth_sum) / weight } else { empty }
}
