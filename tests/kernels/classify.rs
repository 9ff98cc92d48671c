//! `densify/classify` against its twin.

use ashsplat::kernels::constants::{CRITERION_ABSOLUTE, CRITERION_GRADIENT, CRITERION_SELECTED};
use ashsplat::kernels::densify::classify::{Bind, Interface, Push, Spec};

use crate::common::gpu::{Gpu, UNTOUCHED, sizes};
use crate::common::layout::{pack, room};
use crate::common::scenes::{Random, mixed_scene};
use crate::reference::classify::{Decision, GRADIENT_THRESHOLD, Statistic, decide, is_pruned};
use crate::reference::gather::long_axis_child;
use crate::reference::linear::sigmoid;
use crate::reference::types::Gaussian;

const SCENE_EXTENT: f64 = 40.0;

/// Bits of a decision: 1 keep, 2 clone, 4 split.
pub fn decision_bits(gaussian: &Gaussian, statistic: Statistic, prune_big: bool) -> u32 {
    let pruned = |log_scale: [f64; 3]| is_pruned(gaussian.opacity_logit, log_scale, SCENE_EXTENT, prune_big);
    let halves = gaussian.log_scale.map(|s| s - 1.6_f64.ln());
    match decide(gaussian.log_scale, statistic, SCENE_EXTENT) {
        Decision::Split => 4 * u32::from(!pruned(halves)),
        Decision::Clone => 3 * u32::from(!pruned(gaussian.log_scale)),
        Decision::Keep => u32::from(!pruned(gaussian.log_scale)),
    }
}

fn spec(gpu: &Gpu) -> Spec {
    let (workgroup_size, subgroup_size) = (gpu.workgroup(64), gpu.subgroup());
    Spec { workgroup_size, subgroup_size, long_axis: false, criterion: CRITERION_GRADIENT }
}

/// Bits of a decision by a criterion's value; splits are along the long axis.
fn long_axis_bits(gaussian: &Gaussian, (criterion, value): (u32, f64), prune_big: bool) -> u32 {
    let pruned = |g: &Gaussian| is_pruned(g.opacity_logit, g.log_scale, SCENE_EXTENT, prune_big);
    let decision = match (criterion, value > 0.0) {
        (CRITERION_SELECTED, true) => Decision::Split,
        (CRITERION_SELECTED, false) => Decision::Keep,
        _ => decide(gaussian.log_scale, Statistic { gradient: value, views: 1.0 }, SCENE_EXTENT),
    };
    match decision {
        Decision::Split => 4 * u32::from(!pruned(&long_axis_child(gaussian, 0))),
        Decision::Clone => 3 * u32::from(!pruned(gaussian)),
        Decision::Keep => u32::from(!pruned(gaussian)),
    }
}

/// Decisions by absolute statistics and by a selection, with children along the long axis.
#[test]
pub fn decide_by_other_criteria_equals_its_twin() {
    let gpu = Gpu::new();
    let block = gpu.workgroup(64) as usize;
    for (criterion, prune_big) in [(CRITERION_ABSOLUTE, true), (CRITERION_SELECTED, false)] {
        let spec = Spec { long_axis: true, criterion, ..spec(&gpu) };
        for size in sizes(block) {
            let mut random = Random::new(size as u64);
            let mut gaussians = mixed_scene(&mut random, size, 1);
            for gaussian in &mut gaussians {
                gaussian.log_scale = [0; 3].map(|_| random.between(-3.0, 1.8));
                // Opacities around the limit at which a child is too faint.
                gaussian.opacity_logit = random.between(-6.0, -4.0);
            }
            // Opacities so close to a bound that rounding may decide are replaced.
            let clear = |g: &Gaussian| {
                let child = long_axis_child(g, 0);
                let clear = |x: f64, bound: f64| (x / bound - 1.0).abs() > 1e-4;
                [g, &child].iter().all(|g| clear(sigmoid(g.opacity_logit), 0.005))
            };
            gaussians.iter_mut().for_each(|g| {
                if !clear(g) {
                    g.opacity_logit = 1.0
                }
            });
            let views: Vec<f32> = (0..size).map(|_| random.below(10) as f32).collect();
            let means: Vec<f32> = (0..size).map(|_| random.between(0.0, 4e-4) as f32).collect();
            let selected: Vec<u32> = (0..size).map(|_| random.below(2) * 7).collect();
            let criteria: Vec<u32> = match criterion {
                CRITERION_SELECTED => selected.clone(),
                _ => views.iter().zip(&means).map(|(views, mean)| (views * mean).to_bits()).collect(),
            };
            // The sums of the signed norms must be ignored.
            let statistics: Vec<[f32; 2]> = views.iter().map(|&views| [1e9, views]).collect();
            let blocks = size.div_ceil(block);
            let parameters = gpu.buffer("parameters", &pack(&gaussians, room(size)));
            let (statistics, criteria_buffer) =
                (gpu.buffer("statistics", &statistics), gpu.buffer("criteria", &criteria));
            let decisions = gpu.untouched::<u32>("decisions", size + 1);
            let counts = gpu.untouched::<u32>("block_counts", 3 * blocks + 1);
            let bind = Bind {
                parameters: &parameters,
                statistics: &statistics,
                decisions: &decisions,
                block_counts: &counts,
                criteria: &criteria_buffer,
            };
            let push = Push {
                first: 0,
                count: size as u32,
                blocks: blocks as u32,
                gradient_threshold: GRADIENT_THRESHOLD as f32,
                clone_scale: (0.01 * SCENE_EXTENT) as f32,
                min_opacity: 0.005,
                max_scale: if prune_big { (0.1 * SCENE_EXTENT) as f32 } else { 0.0 },
            };
            gpu.dispatch::<Interface>(&spec, &bind, &push, blocks as u64 + 1);
            let value = |i: usize| match criterion {
                CRITERION_SELECTED => f64::from(selected[i]),
                _ if views[i] == 0.0 => 0.0,
                _ => f64::from(f32::from_bits(criteria[i]) / views[i]),
            };
            let expected: Vec<u32> =
                (0..size).map(|i| long_axis_bits(&gaussians[i], (criterion, value(i)), prune_big)).collect();
            let decided = gpu.read::<u32>(&decisions, size + 1);
            assert_eq!(decided[..size], expected, "{size}, criterion {criterion}");
            assert_eq!(decided[size], UNTOUCHED);
        }
    }
}

#[test]
pub fn decide_equals_its_twin() {
    let gpu = Gpu::new();
    let spec = spec(&gpu);
    let block = spec.workgroup_size as usize;
    for (size, prune_big) in sizes(block).into_iter().flat_map(|n| [(n, false), (n, true)]) {
        let mut random = Random::new(size as u64);
        let mut gaussians = mixed_scene(&mut random, size, 1);
        let statistics: Vec<[f32; 2]> = (0..size)
            .map(|_| {
                let views = random.below(10) as f32;
                [views * random.between(0.0, 4e-4) as f32, views]
            })
            .collect();
        for gaussian in &mut gaussians {
            // Scales around the bounds of cloning (0.4) and pruning (4).
            gaussian.log_scale = [0; 3].map(|_| random.between(-3.0, 1.8));
        }
        let blocks = size.div_ceil(block);
        let parameters = gpu.buffer("parameters", &pack(&gaussians, room(size)));
        let statistics_buffer = gpu.buffer("statistics", &statistics);
        let decisions = gpu.untouched::<u32>("decisions", size + 1);
        let counts = gpu.untouched::<u32>("block_counts", 3 * blocks + 1);
        let bind = Bind {
            parameters: &parameters,
            statistics: &statistics_buffer,
            decisions: &decisions,
            block_counts: &counts,
            criteria: &statistics_buffer,
        };
        let push = Push {
            first: 0,
            count: size as u32,
            blocks: blocks as u32,
            gradient_threshold: GRADIENT_THRESHOLD as f32,
            clone_scale: (0.01 * SCENE_EXTENT) as f32,
            min_opacity: 0.005,
            max_scale: if prune_big { (0.1 * SCENE_EXTENT) as f32 } else { 0.0 },
        };
        gpu.dispatch::<Interface>(&spec, &bind, &push, blocks as u64 + 1);
        let expected: Vec<u32> = gaussians
            .iter()
            .zip(&statistics)
            .map(|(gaussian, &[gradient, views])| {
                let statistic = Statistic { gradient: gradient.into(), views: views.into() };
                decision_bits(gaussian, statistic, prune_big)
            })
            .collect();
        let decided = gpu.read::<u32>(&decisions, size + 1);
        assert_eq!(decided[..size], expected, "{size}, {prune_big}");
        assert_eq!(decided[size], UNTOUCHED);
        let counts = gpu.read::<u32>(&counts, 3 * blocks + 1);
        for bit in 0..3 {
            let counted: Vec<u32> =
                expected.chunks(block).map(|bits| bits.iter().map(|bits| bits >> bit & 1).sum()).collect();
            assert_eq!(counts[bit * blocks..(bit + 1) * blocks], counted, "{size}, bit {bit}");
        }
        assert_eq!(counts[3 * blocks], UNTOUCHED);
    }
}
