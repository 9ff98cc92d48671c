//! `sort/sort_spine` against its twin.

use ashsplat::kernels::sort::sort_spine::{Bind, Interface, Push, Spec};

use crate::common::gpu::{Gpu, UNTOUCHED, sizes};
use crate::common::scenes::Random;
use crate::reference::sort_spine::sort_spine;

#[test]
pub fn sort_spine_equals_its_twin() {
    let gpu = Gpu::new();
    for whole_rows in [false, true] {
        check(&gpu, whole_rows);
    }
}

fn check(gpu: &Gpu, whole_rows: bool) {
    let spec = Spec { workgroup_size: gpu.workgroup(64), subgroup_size: gpu.subgroup(), whole_rows };
    let block_size = 8;
    // The last workgroup has more rows than there are digits.
    let digits = 21;
    let rows = if whole_rows { 1 } else { spec.workgroup_size / spec.subgroup_size };
    let workgroups = u64::from(digits as u32 / rows + 1);
    // Sizes around one round of either form.
    let of_rows =
        sizes(spec.workgroup_size as usize).into_iter().chain(sizes(4 * spec.workgroup_size as usize));
    for blocks in of_rows {
        let mut random = Random::new(blocks as u64);
        let rows: Vec<u32> = (0..blocks * digits).map(|_| random.below(1000)).collect();
        let keys = if blocks == 0 { 0 } else { blocks as u32 * block_size - 3 };
        let counts = gpu.buffer("counts", &[keys]);
        let histogram = gpu.buffer("histogram", &[rows.as_slice(), &[UNTOUCHED; 2]].concat());
        let totals = gpu.untouched::<u32>("digit_totals", digits + 1);
        let bind = Bind { counts: &counts, histogram: &histogram, digit_totals: &totals };
        let push = Push { count_index: 0, block_size, digits: digits as u32 };
        gpu.dispatch::<Interface>(&spec, &bind, &push, workgroups);
        let mut expected = rows;
        let expected_totals = sort_spine(&mut expected, blocks, digits);
        expected.extend([UNTOUCHED; 2]);
        assert_eq!(gpu.read::<u32>(&histogram, expected.len()), expected, "{blocks} blocks");
        let totals = gpu.read::<u32>(&totals, digits + 1);
        assert_eq!(totals[..digits], expected_totals, "{blocks} blocks");
        assert_eq!(totals[digits], UNTOUCHED, "{blocks} blocks");
    }
}
