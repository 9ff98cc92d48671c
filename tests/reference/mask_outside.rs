//! Sets statistics of Gaussians outside a box below every threshold; the twin of `densify/mask_outside`.

/// Sum of norms of a Gaussian with this mean. The box includes its sides.
pub fn masked(sum: f64, mean: [f64; 3], [low, high]: [[f64; 3]; 2]) -> f64 {
    let inside = (0..3).all(|axis| low[axis] <= mean[axis] && mean[axis] <= high[axis]);
    if inside { sum } else { f64::from(-3e38_f32) }
}
