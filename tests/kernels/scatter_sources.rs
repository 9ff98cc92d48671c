//! `densify/scatter_sources` against its twin.

use ashsplat::kernels::densify::scatter_sources::{Bind, Interface, Push, Spec};

use super::classify::decision_bits;
use crate::common::gpu::{Gpu, UNTOUCHED, sizes};
use crate::common::scenes::{Random, mixed_scene};
use crate::reference::classify::Statistic;
use crate::reference::scan_spine::scan_spine;
use crate::reference::scatter_sources::{Densify, Kind, place};

/// The order of the twin, which appends and then prunes as the reference implementation does. The kernel's decisions
/// already include the pruning.
#[test]
fn place_equals_its_twin() {
    let gpu = Gpu::new();
    let spec = Spec { workgroup_size: gpu.workgroup(64), subgroup_size: gpu.subgroup() };
    let kernel = gpu.kernel::<Interface>(&spec);
    let block = spec.workgroup_size as usize;
    for (size, dropped) in sizes(block).into_iter().flat_map(|n| [(n, 0), (n, 3)]) {
        let mut random = Random::new(size as u64);
        let gaussians = mixed_scene(&mut random, size, 1);
        let statistics: Vec<Statistic> =
            (0..size).map(|_| Statistic { gradient: random.between(0.0, 4e-4), views: 1.0 }).collect();
        let decisions: Vec<u32> =
            gaussians.iter().zip(&statistics).map(|(g, s)| decision_bits(g, *s, true)).collect();
        let blocks = size.div_ceil(block);
        let mut offsets = Vec::new();
        let mut totals = Vec::new();
        for bit in 0..3 {
            let mut counts: Vec<u32> =
                decisions.chunks(block).map(|bits| bits.iter().map(|bits| bits >> bit & 1).sum()).collect();
            totals.push(scan_spine(&mut counts));
            offsets.extend(counts);
        }
        let twin =
            place(&gaussians, &statistics, Densify { scene_extent: 40.0, prune_big: true }, |_, _| [0.0; 3]);
        let mut second_halves = 0;
        let expected: Vec<u32> = twin
            .iter()
            .map(|placed| {
                let kind = match placed.kind {
                    Kind::Kept => 0,
                    Kind::Clone => 1,
                    // All the first halves stand in front of all the second ones.
                    Kind::Child => {
                        second_halves += 1;
                        if second_halves > totals[2] { 3 } else { 2 }
                    }
                };
                placed.parent as u32 | kind << 30
            })
            .collect();
        // A capacity below the need drops the last rows.
        let capacity = expected.len().saturating_sub(dropped);
        let [decisions, block_offsets, totals_buffer] =
            [("decisions", &decisions), ("block_offsets", &offsets), ("totals", &totals)]
                .map(|(name, words)| gpu.buffer(name, words));
        let sources = gpu.untouched::<u32>("sources", capacity + 2);
        let bind = Bind {
            decisions: &decisions,
            block_offsets: &block_offsets,
            totals: &totals_buffer,
            sources: &sources,
        };
        let push = Push { count: size as u32, blocks: blocks as u32, capacity: capacity as u32 };
        gpu.run(|recorder| recorder.dispatch(&kernel, &bind, &push, blocks as u64));
        let mut expected = expected[..capacity].to_vec();
        expected.extend([UNTOUCHED; 2]);
        assert_eq!(gpu.read::<u32>(&sources, capacity + 2), expected, "{size}");
    }
}
