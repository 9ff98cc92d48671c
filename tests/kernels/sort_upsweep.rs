//! `sort/sort_upsweep` against its twin.

use ashsplat::kernels::sort::sort_upsweep::{Bind, Interface, Push, Spec};

use crate::common::gpu::{Gpu, UNTOUCHED, sizes};
use crate::common::scenes::Random;
use crate::reference::sort_upsweep::sort_upsweep;

#[test]
pub fn sort_upsweep_equals_its_twin() {
    let gpu = Gpu::new();
    check_sizes(&gpu, Spec { workgroup_size: gpu.workgroup(64), items: 4 });
}

/// Key counts around multiples of a block, random keys, all digits.
pub fn check_sizes(gpu: &Gpu, spec: Spec) {
    let block = (spec.workgroup_size * spec.items) as usize;
    for (size, shift, bits) in
        sizes(block).into_iter().flat_map(|n| [(n, 0, 8), (n, 24, 8), (n, 8, 5), (n, 31, 1)])
    {
        let mut random = Random::new(size as u64);
        let keys: Vec<u32> = (0..size).map(|_| random.bits() as u32).collect();
        let (counts, input) = (gpu.buffer("counts", &[0, size as u32]), gpu.buffer("keys", &keys));
        let blocks = size.div_ceil(block);
        let length = (blocks << bits) + 2;
        let histogram = gpu.untouched::<u32>("histogram", length);
        let bind = Bind { counts: &counts, keys: &input, histogram: &histogram };
        let push = Push { count_index: 1, shift, bits };
        gpu.dispatch::<Interface>(&spec, &bind, &push, blocks as u64 + 1);
        let mut expected = sort_upsweep(&keys, shift, bits, block);
        expected.extend([UNTOUCHED; 2]);
        assert_eq!(gpu.read::<u32>(&histogram, length), expected, "size {size}, {bits} bits at {shift}");
    }
}
