//! `forward/count` against its twin.

use ashsplat::kernels::forward::count::{Bind, Interface, Push, Spec};

use crate::common::frame::{shuffled, state};
use crate::common::gpu::{Gpu, UNTOUCHED, sizes};
use crate::common::scenes::Random;
use crate::reference::count::ordered;
use crate::reference::scan_reduce::scan_reduce;
use crate::reference::tile_list::{LISTED, tiles_met};

#[test]
pub fn count_equals_its_twin() {
    let gpu = Gpu::new();
    let spec = Spec { workgroup_size: gpu.workgroup(64), subgroup_size: gpu.subgroup(), items: 4 };
    let block = (spec.workgroup_size * spec.items) as usize;
    for size in sizes(block) {
        let mut random = Random::new(size as u64);
        let lists: Vec<[u32; 2]> = (0..size)
            .map(|_| match random.below(2) {
                0 => [random.below(5000), 0],
                _ => [LISTED | random.below(32) << 26 | random.below(1 << 26), random.below(u32::MAX)],
            })
            .collect();
        let order = shuffled(size);
        let lists_in_order = ordered(&order, &lists);
        let expected: Vec<u32> = lists_in_order.iter().copied().map(tiles_met).collect();
        let sums = scan_reduce(&expected, block);
        let (state, order) = (state(&gpu, size, 0), gpu.buffer("order", &order));
        let tile_lists = gpu.buffer("tile_lists", &lists);
        let [tiles_touched, list_heads, list_rows] =
            ["tiles_touched", "list_heads", "list_rows"].map(|name| gpu.untouched::<u32>(name, size + 2));
        let block_sums = gpu.untouched::<u32>("block_sums", sums.len() + 1);
        let bind = Bind {
            state: &state,
            order: &order,
            tile_lists: &tile_lists,
            tiles_touched: &tiles_touched,
            list_heads: &list_heads,
            list_rows: &list_rows,
            block_sums: &block_sums,
        };
        gpu.dispatch::<Interface>(&spec, &bind, &Push::default(), (size / block) as u64 + 1);
        let [heads, rows] =
            [0, 1].map(|word| lists_in_order.iter().map(|list| list[word]).collect::<Vec<_>>());
        for (buffer, expected) in [(&tiles_touched, &expected), (&list_heads, &heads), (&list_rows, &rows)] {
            let actual = gpu.read::<u32>(buffer, size + 2);
            assert_eq!(
                actual,
                [expected.as_slice(), &[UNTOUCHED; 2]].concat(),
                "{}, size {size}",
                buffer.name()
            );
        }
        let actual = gpu.read::<u32>(&block_sums, sums.len() + 1);
        assert_eq!(actual, [sums.as_slice(), &[UNTOUCHED]].concat(), "size {size}");
    }
}
