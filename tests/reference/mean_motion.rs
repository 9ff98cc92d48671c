//! The mean motion of a pixel, the twin of `compose/mean_motion`.

/// sum(w m) / sum(w), px; None if the weights sum to less than `min_weight`.
pub fn mean_motion(transmittance: f32, sum: [f32; 2], min_weight: f64) -> Option<[f64; 2]> {
    let weight = 1.0 - f64::from(transmittance);
    (weight >= min_weight && weight > 0.0)
        .then(|| sum.map(|x| (f64::from(x) / weight).clamp(-65504.0, 65504.0)))
}
