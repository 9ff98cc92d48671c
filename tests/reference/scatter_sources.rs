//! The Gaussians after densification in the reference implementation's order, the twin of `densify/scatter_sources`.

use super::classify::{Decision, Statistic, decide, is_pruned};
use super::gather::child_of;
use super::types::Gaussian;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    Kept = 0,
    Clone = 1,
    /// Half of a split Gaussian.
    Child = 2,
}

#[derive(Clone, Debug)]
pub struct Placed {
    /// Its index before densification; the parent's for clones and children.
    pub parent: usize,
    pub kind: Kind,
    pub gaussian: Gaussian,
}

#[derive(Clone, Copy, Debug)]
pub struct Densify {
    pub scene_extent: f64,
    /// Also prune Gaussians larger than a tenth of the scene.
    pub prune_big: bool,
}

/// Places survivors first, then clones, then all first children, then all second children; then prunes.
/// `noise(child, split)` returns standard normal numbers for a child of the split-th split Gaussian.
pub fn place(
    gaussians: &[Gaussian],
    statistics: &[Statistic],
    settings: Densify,
    noise: impl Fn(usize, usize) -> [f64; 3],
) -> Vec<Placed> {
    let decisions: Vec<Decision> = gaussians
        .iter()
        .zip(statistics)
        .map(|(gaussian, statistic)| decide(gaussian.log_scale, *statistic, settings.scene_extent))
        .collect();
    let having = |wanted: fn(Decision) -> bool| {
        decisions.iter().enumerate().filter(move |(_, d)| wanted(**d)).map(|(parent, _)| parent)
    };
    let mut placed: Vec<Placed> = Vec::new();
    for parent in having(|decision| decision != Decision::Split) {
        placed.push(Placed { parent, kind: Kind::Kept, gaussian: gaussians[parent].clone() });
    }
    for parent in having(|decision| decision == Decision::Clone) {
        placed.push(Placed { parent, kind: Kind::Clone, gaussian: gaussians[parent].clone() });
    }
    for child in 0..2 {
        for (split, parent) in having(|decision| decision == Decision::Split).enumerate() {
            let gaussian = child_of(&gaussians[parent], noise(child, split));
            placed.push(Placed { parent, kind: Kind::Child, gaussian });
        }
    }
    placed.retain(|p| {
        let Gaussian { opacity_logit, log_scale, .. } = p.gaussian;
        !is_pruned(opacity_logit, log_scale, settings.scene_extent, settings.prune_big)
    });
    placed
}
