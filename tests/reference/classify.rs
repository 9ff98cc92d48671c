//! Which Gaussians are cloned and split (spec: "Densify"), and statistics of those outside a box: the twins of
//! `densify/classify` and `densify/mask_outside`.

use super::linear::sigmoid;

/// Gradient norm from which a Gaussian is densified.
pub const GRADIENT_THRESHOLD: f64 = 2e-4_f32 as f64;
/// Share of the scene extent up to which a Gaussian is cloned, above which it is split.
pub const PERCENT_DENSE: f64 = 0.01;
/// Opacity under which a Gaussian is pruned.
pub const OPACITY_MIN: f64 = 0.005;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Decision {
    Keep,
    /// A copy in place, both kept.
    Clone,
    /// Two smaller ones instead of it.
    Split,
}

/// Sums over the views since the last densification.
#[derive(Clone, Copy, Debug)]
pub struct Statistic {
    /// Sum of the 2-D mean's gradient norms in normalised device units.
    pub gradient: f64,
    /// Number of views in which the Gaussian was visible.
    pub views: f64,
}

pub fn decide(log_scale: [f64; 3], statistic: Statistic, scene_extent: f64) -> Decision {
    let mean = if statistic.views > 0.0 { statistic.gradient / statistic.views } else { 0.0 };
    if mean < GRADIENT_THRESHOLD {
        Decision::Keep
    } else if largest_scale(log_scale) <= PERCENT_DENSE * scene_extent {
        Decision::Clone
    } else {
        Decision::Split
    }
}

/// True if a Gaussian is pruned. `prune_big` also prunes those larger than a tenth of the scene.
pub fn is_pruned(opacity_logit: f64, log_scale: [f64; 3], scene_extent: f64, prune_big: bool) -> bool {
    sigmoid(opacity_logit) < OPACITY_MIN || (prune_big && largest_scale(log_scale) > 0.1 * scene_extent)
}

fn largest_scale(log_scale: [f64; 3]) -> f64 {
    log_scale.iter().copied().fold(f64::NEG_INFINITY, f64::max).exp()
}

/// Sum of norms of a Gaussian with this mean: below every threshold outside the box. The box includes its sides.
pub fn masked(sum: f64, mean: [f64; 3], [low, high]: [[f64; 3]; 2]) -> f64 {
    let inside = (0..3).all(|axis| low[axis] <= mean[axis] && mean[axis] <= high[axis]);
    if inside { sum } else { f64::from(-3e38_f32) }
}
