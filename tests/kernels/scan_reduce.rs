//! `scan/scan_reduce` against its twin.

use ashsplat::kernels::scan::scan_reduce::{Bind, Interface, Push, Spec};

use crate::common::gpu::{Gpu, UNTOUCHED, sizes};
use crate::common::scenes::Random;
use crate::reference::scan_reduce::scan_reduce;

#[test]
pub fn scan_reduce_equals_its_twin() {
    let gpu = Gpu::new();
    check(&gpu, Spec { workgroup_size: gpu.workgroup(64), subgroup_size: gpu.subgroup(), items: 4 });
    // A single subgroup needs no barrier.
    check(&gpu, Spec { workgroup_size: gpu.subgroup(), subgroup_size: gpu.subgroup(), items: 12 });
}

fn check(gpu: &Gpu, spec: Spec) {
    let block = (spec.workgroup_size * spec.items) as usize;
    for size in sizes(block) {
        let mut random = Random::new(size as u64);
        let values: Vec<u32> = (0..size).map(|_| random.bits() as u32).collect();
        let (counts, input) = (gpu.buffer("counts", &[7, size as u32]), gpu.buffer("values", &values));
        let blocks = size.div_ceil(block);
        let sums = gpu.untouched::<u32>("block_sums", blocks + 2);
        let bind = Bind { counts: &counts, values: &input, block_sums: &sums };
        // One workgroup more than needed: it must write nothing.
        gpu.dispatch::<Interface>(&spec, &bind, &Push { count_index: 1 }, blocks as u64 + 1);
        let mut expected = scan_reduce(&values, block);
        expected.extend([UNTOUCHED; 2]);
        assert_eq!(gpu.read::<u32>(&sums, blocks + 2), expected, "size {size}");
    }
}
