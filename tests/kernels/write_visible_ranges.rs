//! `forward/write_visible_ranges` against its twin.

use ashsplat::kernels::forward::write_visible_ranges::{Bind, Interface, Push, Spec};

use crate::common::frame::state;
use crate::common::gpu::{Gpu, UNTOUCHED};
use crate::common::scenes::Random;
use crate::reference::scan_spine::scan_spine;
use crate::reference::write_indirect_args::workgroups;
use crate::reference::write_visible_ranges::ranges;

#[test]
fn prepare_ranges_equals_its_twin() {
    let gpu = Gpu::new();
    let spec = Spec { workgroup_size: gpu.workgroup(64) };
    let kernel = gpu.kernel::<Interface>(&spec);
    let scenes =
        [(1, 0..1, 1), (1, 0..1, 5), (5, 0..5, 5), (6, 0..6, 5), (300, 0..300, 3), (1000, 0..1000, 1)];
    // One of several scenes, with and without others behind it.
    let some = [(20, 3..9, 4), (20, 7..20, 4), (20, 0..8, 4)];
    for (blocks, own, blocks_per_range) in scenes.into_iter().chain(some) {
        for most in [1, 300] {
            let mut random = Random::new(blocks as u64);
            let mut offsets: Vec<u32> = (0..blocks).map(|_| random.below(most)).collect();
            let visible = scan_spine(&mut offsets);
            let expected = ranges(&offsets, visible, own.clone(), blocks_per_range);
            let state = state(&gpu, visible as usize, 0);
            let block_offsets = gpu.buffer("block_offsets", &offsets);
            let visible_ranges = gpu.untouched::<[u32; 4]>("visible_ranges", 2 * blocks + 1);
            let bind = Bind { state: &state, block_offsets: &block_offsets, visible_ranges: &visible_ranges };
            let push = Push {
                ranges: expected.len() as u32,
                blocks: blocks as u32,
                first_block: own.start as u32,
                own_blocks: own.len() as u32,
                blocks_per_range: blocks_per_range as u32,
                block_elementwise: 64,
                max_workgroups_per_axis: 7,
            };
            let count = expected.len() as u64 / u64::from(spec.workgroup_size) + 1;
            gpu.run(|recorder| recorder.dispatch(&kernel, &bind, &push, count));
            let mut actual = gpu.read::<[u32; 4]>(&visible_ranges, 2 * blocks + 1);
            for (range, &[begin, end]) in expected.iter().enumerate() {
                let what = format!("range {range} of blocks {own:?} of {blocks}, {blocks_per_range} each");
                let block = own.start + range * blocks_per_range;
                assert_eq!(actual[2 * block][..3], workgroups(end - begin, 64, 7), "{what}");
                assert_eq!(actual[2 * block + 1], [begin, end, 0, 0], "{what}");
                actual[2 * block] = [UNTOUCHED; 4];
                actual[2 * block + 1] = [UNTOUCHED; 4];
            }
            assert!(actual.iter().all(|words| *words == [UNTOUCHED; 4]), "more was written");
        }
    }
}
