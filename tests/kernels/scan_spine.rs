//! `scan/scan_spine` against its twin.

use ashsplat::kernels::scan::scan_spine::{Bind, Interface, Push, Spec};

use crate::common::gpu::{Gpu, UNTOUCHED, sizes};
use crate::common::scenes::Random;
use crate::reference::scan_spine::scan_spine;

#[test]
pub fn scan_spine_equals_its_twin() {
    let gpu = Gpu::new();
    for items in [1, 4] {
        check(&gpu, items);
    }
}

fn check(gpu: &Gpu, items: u32) {
    let spec = Spec { workgroup_size: gpu.workgroup(64), subgroup_size: gpu.subgroup(), items };
    let block_size = 24;
    for size in sizes((spec.workgroup_size * items) as usize) {
        for from_totals in [0, 1] {
            let mut random = Random::new(size as u64);
            // With few sums the total fits into 32 bits, with many it saturates.
            let sums: Vec<u32> = (0..size).map(|_| random.below(1 << 27)).collect();
            // The last block is not full.
            let values = if size == 0 { 0 } else { size as u32 * block_size - 5 };
            // The sums start behind three other words.
            let input =
                gpu.buffer("block_sums", &[&[UNTOUCHED; 3], sums.as_slice(), &[UNTOUCHED; 2]].concat());
            let totals = gpu.buffer("totals", &[1, 2, 3, values]);
            let push = Push {
                count: if from_totals == 1 { 3 } else { values },
                from_totals,
                block_size,
                total_index: 1,
                first_sum: 3,
            };
            let bind = Bind { block_sums: &input, totals: &totals };
            gpu.dispatch::<Interface>(&spec, &bind, &push, 1);
            let mut expected = sums;
            let total = scan_spine(&mut expected);
            let expected = [&[UNTOUCHED; 3], expected.as_slice(), &[UNTOUCHED; 2]].concat();
            assert_eq!(gpu.read::<u32>(&input, size + 5), expected, "size {size}");
            assert_eq!(gpu.read::<u32>(&totals, 4), [1, total, 3, values], "size {size}");
        }
    }
}

/// A total that wraps around must not look like a small one, wherever the carry occurs.
#[test]
pub fn scan_spine_saturates_exactly_beyond_32_bits() {
    let gpu = Gpu::new();
    for items in [1, 4] {
        check_saturation(&gpu, items);
    }
}

fn check_saturation(gpu: &Gpu, items: u32) {
    let spec = Spec { workgroup_size: gpu.workgroup(64), subgroup_size: gpu.subgroup(), items };
    let far = (spec.workgroup_size * items) as usize + 1;
    for (last, place) in [(0, 1), (1, 1), (2, 1), (0, far), (1, far), (2, far), (u32::MAX, far)] {
        let mut sums = vec![0; far + 1];
        sums[0] = u32::MAX - 1;
        sums[place] = last;
        let (input, totals) = (gpu.buffer("block_sums", &sums), gpu.buffer("totals", &[7_u32]));
        let count = sums.len() as u32;
        let push = Push { count, from_totals: 0, block_size: 1, total_index: 0, first_sum: 0 };
        let bind = Bind { block_sums: &input, totals: &totals };
        gpu.dispatch::<Interface>(&spec, &bind, &push, 1);
        let total = scan_spine(&mut sums);
        assert_eq!(total, (u32::MAX - 1).saturating_add(last));
        assert_eq!(gpu.read::<u32>(&totals, 1), [total], "{last} at {place}");
        assert_eq!(gpu.read::<u32>(&input, far + 1), sums, "{last} at {place}");
    }
}
