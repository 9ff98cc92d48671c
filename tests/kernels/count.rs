//! `forward/count` against its twin.

use ashsplat::kernels::forward::count::{Bind, Interface, Push, Spec};

use crate::common::frame::{shuffled, state};
use crate::common::gpu::{Gpu, UNTOUCHED, sizes};
use crate::common::scenes::Random;
use crate::reference::count::ordered;
use crate::reference::scan_reduce::scan_reduce;

#[test]
fn count_equals_its_twin() {
    let gpu = Gpu::new();
    let spec = Spec { workgroup_size: gpu.workgroup(64), subgroup_size: gpu.subgroup(), items: 4 };
    let kernel = gpu.kernel::<Interface>(&spec);
    let block = (spec.workgroup_size * spec.items) as usize;
    for size in sizes(block) {
        let mut random = Random::new(size as u64);
        let tiles: Vec<u32> = (0..size).map(|_| random.below(9)).collect();
        let order = shuffled(size);
        let expected = ordered(&order, &tiles);
        let sums = scan_reduce(&expected, block);
        let (state, order) = (state(&gpu, size, 0), gpu.buffer("order", &order));
        let visible_tiles = gpu.buffer("visible_tiles", &tiles);
        let tile_counts = gpu.untouched::<u32>("tile_counts", size + 2);
        let block_sums = gpu.untouched::<u32>("block_sums", sums.len() + 1);
        let bind = Bind {
            state: &state,
            order: &order,
            visible_tiles: &visible_tiles,
            tile_counts: &tile_counts,
            block_sums: &block_sums,
        };
        gpu.run(|recorder| recorder.dispatch(&kernel, &bind, &Push::default(), (size / block) as u64 + 1));
        let actual = gpu.read::<u32>(&tile_counts, size + 2);
        assert_eq!(actual, [expected.as_slice(), &[UNTOUCHED; 2]].concat(), "size {size}");
        let actual = gpu.read::<u32>(&block_sums, sums.len() + 1);
        assert_eq!(actual, [sums.as_slice(), &[UNTOUCHED]].concat(), "size {size}");
    }
}
