//! `forward/write_visible_ranges` against its twin.

use std::ops::Range;

use ashsplat::kernels::blocks::CameraBlock;
use ashsplat::kernels::constants::{STATE_FIRST_SCENE_VISIBLE, STATE_WORDS};
use ashsplat::kernels::forward::write_visible_ranges::{Bind, Interface, Push, Spec};

use crate::common::frame::state;
use crate::common::gpu::{Gpu, UNTOUCHED};
use crate::common::layout::scene_blocks;
use crate::common::scenes::Random;
use crate::reference::scan_spine::scan_spine;
use crate::reference::write_indirect_args::workgroups;
use crate::reference::write_visible_ranges::ranges;

/// Gaussians of a culling block.
const BLOCK: u32 = 64;

/// A frame of `blocks` blocks; each scene has its own blocks and a number of blocks per range.
fn check(gpu: &Gpu, blocks: usize, scenes: &[(Range<usize>, usize)], most: u32) {
    let spec = Spec { workgroup_size: gpu.workgroup(64) };
    let kernel = gpu.kernel::<Interface>(&spec);
    let mut random = Random::new(blocks as u64);
    let mut offsets: Vec<u32> = (0..blocks).map(|_| random.below(most)).collect();
    let visible = scan_spine(&mut offsets);
    let table = scenes.iter().map(|(own, blocks_per_range)| CameraBlock {
        scene_first: own.start as u32 * BLOCK,
        // The last block need not be full.
        scene_count: (own.len() as u32 * BLOCK).saturating_sub(random.below(BLOCK)),
        scene_chunk_gaussians: *blocks_per_range as u32 * BLOCK,
        ..CameraBlock::default()
    });
    let table = scene_blocks(&table.collect::<Vec<_>>());
    let state = state(gpu, visible as usize, 0);
    let block_offsets = gpu.buffer("block_offsets", &offsets);
    let visible_ranges = gpu.untouched::<[u32; 4]>("visible_ranges", 2 * blocks + 1);
    let bind = Bind {
        state: &state,
        block_offsets: &block_offsets,
        visible_ranges: &visible_ranges,
        scene_blocks: &gpu.buffer("scene_blocks", &table),
    };
    let push = Push {
        scenes: scenes.len() as u32,
        blocks: blocks as u32,
        block_elementwise: BLOCK,
        max_workgroups_per_axis: 7,
    };
    let count = scenes.len() as u64 / u64::from(spec.workgroup_size) + 1;
    gpu.run(|recorder| recorder.dispatch(&kernel, &bind, &push, count));
    let (first_scene, blocks_per_range) = &scenes[0];
    let last = ranges(&offsets, visible, first_scene.clone(), *blocks_per_range).pop();
    let words = gpu.read::<u32>(&state, STATE_WORDS as usize);
    assert_eq!(words[STATE_FIRST_SCENE_VISIBLE as usize], last.map_or(0, |[_, end]| end), "{first_scene:?}");
    let mut actual = gpu.read::<[u32; 4]>(&visible_ranges, 2 * blocks + 1);
    for (own, blocks_per_range) in scenes {
        let expected = ranges(&offsets, visible, own.clone(), *blocks_per_range);
        for (range, &[begin, end]) in expected.iter().enumerate() {
            let what = format!("range {range} of blocks {own:?} of {blocks}, {blocks_per_range} each");
            let block = own.start + range * blocks_per_range;
            assert_eq!(actual[2 * block][..3], workgroups(end - begin, BLOCK, 7), "{what}");
            assert_eq!(actual[2 * block + 1], [begin, end, 0, 0], "{what}");
            actual[2 * block] = [UNTOUCHED; 4];
            actual[2 * block + 1] = [UNTOUCHED; 4];
        }
    }
    assert!(actual.iter().all(|words| *words == [UNTOUCHED; 4]), "more was written");
}

#[test]
fn prepare_ranges_equals_its_twin() {
    let gpu = Gpu::new();
    // One scene, alone and among others.
    let alone =
        [(1, 0..1, 1), (1, 0..1, 5), (5, 0..5, 5), (6, 0..6, 5), (300, 0..300, 3), (1000, 0..1000, 1)];
    let one_of_some = [(20, 3..9, 4), (20, 7..20, 4), (20, 0..8, 4)];
    for most in [1, 300] {
        for (blocks, own, blocks_per_range) in alone.iter().chain(&one_of_some).cloned() {
            check(&gpu, blocks, &[(own, blocks_per_range)], most);
        }
        // Scenes that are not drawn: between two others, and behind all.
        check(&gpu, 20, &[(0..5, 2), (5..5, 1), (5..6, 3), (6..20, 4), (20..20, 1)], most);
        let many: Vec<_> = (0..200).map(|scene| (2 * scene..2 * scene + 2, 1 + scene % 3)).collect();
        check(&gpu, 400, &many, most);
    }
}
