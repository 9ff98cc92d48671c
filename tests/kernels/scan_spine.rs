//! `scan/scan_spine` against its twin.

use ashsplat::kernels::scan::scan_spine::{Bind, Interface, Push, Spec};

use crate::common::gpu::{Gpu, UNTOUCHED, sizes};
use crate::common::scenes::Random;
use crate::reference::scan_spine::scan_spine;

#[test]
fn scan_spine_equals_its_twin() {
    let gpu = Gpu::new();
    let spec = Spec { workgroup_size: gpu.workgroup(64), subgroup_size: gpu.subgroup() };
    let kernel = gpu.kernel::<Interface>(&spec);
    let block_size = 24;
    for size in sizes(spec.workgroup_size as usize) {
        for from_totals in [0, 1] {
            let mut random = Random::new(size as u64);
            let sums: Vec<u32> = (0..size).map(|_| random.bits() as u32).collect();
            // The last block is not full.
            let values = if size == 0 { 0 } else { size as u32 * block_size - 5 };
            // The sums start behind three words of something else.
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
            gpu.run(|recorder| recorder.dispatch(&kernel, &bind, &push, 1));
            let mut expected = sums;
            let total = scan_spine(&mut expected);
            let expected = [&[UNTOUCHED; 3], expected.as_slice(), &[UNTOUCHED; 2]].concat();
            assert_eq!(gpu.read::<u32>(&input, size + 5), expected, "size {size}");
            assert_eq!(gpu.read::<u32>(&totals, 4), [1, total, 3, values], "size {size}");
        }
    }
}
