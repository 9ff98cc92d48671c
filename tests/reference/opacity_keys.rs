//! Sorted opacities: the twin of `densify/opacity_keys` and of the sort by its keys.

use super::linear::sigmoid;

/// The opacities in ascending order.
pub fn sorted(logits: &[f64]) -> Vec<f64> {
    let mut opacities: Vec<f64> = logits.iter().copied().map(sigmoid).collect();
    opacities.sort_by(f64::total_cmp);
    opacities
}
