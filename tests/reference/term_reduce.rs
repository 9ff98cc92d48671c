//! A loss term that is a mean over Gaussians, for the regularisers: the twin of `loss/term_reduce`.

use super::regularize::Sums;

/// Returns the weighted sum, the mean opacity and the mean scale.
pub fn losses(sums: &Sums, count: usize, weights: [f64; 2]) -> [f64; 3] {
    let (opacity, scale) = (sums.opacity / count as f64, sums.scale / (3 * count) as f64);
    [weights[0] * opacity + weights[1] * scale, opacity, scale]
}
