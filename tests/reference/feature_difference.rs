//! Differences of normalised features (Zhang et al. 2018, equation 1), the twin of `lpips/feature_difference`.

use super::convolve::Features;

/// Differences per pixel, row by row.
pub fn feature_difference(a: &Features, b: &Features, head: &[f64]) -> Vec<f64> {
    let norm = |features: &Features, y: usize, x: usize| {
        (0..features.channels).map(|c| features.at(c, y, x).powi(2)).sum::<f64>().sqrt() + 1e-10
    };
    let mut differences = Vec::new();
    for (y, x) in (0..a.height).flat_map(|y| (0..a.width).map(move |x| (y, x))) {
        let (norm_a, norm_b) = (norm(a, y, x), norm(b, y, x));
        let channel = |c: usize| head[c] * (a.at(c, y, x) / norm_a - b.at(c, y, x) / norm_b).powi(2);
        differences.push((0..a.channels).map(channel).sum());
    }
    differences
}
