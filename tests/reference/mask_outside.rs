//! Statistics of Gaussians outside of a box fall below every threshold; the twin of `densify/mask_outside`.

/// The sum of norms of a Gaussian with this mean, for a box between two corners, whose sides belong to it.
pub fn masked(sum: f64, mean: [f64; 3], [low, high]: [[f64; 3]; 2]) -> f64 {
    let inside = (0..3).all(|axis| low[axis] <= mean[axis] && mean[axis] <= high[axis]);
    if inside { sum } else { f64::from(-3e38_f32) }
}
