//! `sort/sort_upsweep_serial` against its twin.

use ashsplat::kernels::sort::sort_upsweep_serial::{Bind, Interface, Push, Spec};

use crate::common::gpu::{Gpu, UNTOUCHED, sizes};
use crate::common::scenes::Random;
use crate::reference::sort_upsweep::sort_upsweep;
use crate::reference::sort_upsweep_serial::sort_upsweep_serial;

#[test]
fn sort_upsweep_serial_equals_its_twin() {
    let gpu = Gpu::new();
    let lanes = gpu.subgroup();
    let spec = Spec { workgroup_size: lanes, subgroup_size: lanes, items: 12 };
    let kernel = gpu.kernel::<Interface>(&spec);
    let (run, block) = (spec.items as usize, (lanes * spec.items) as usize);
    let sizes = sizes(block).into_iter().chain([3, 4, 5, run - 1, run, run + 1, 2 * run + 7]);
    for (size, shift, bits) in sizes.flat_map(|n| [(n, 0, 8), (n, 24, 8), (n, 8, 5), (n, 31, 1), (n, 3, 10)])
    {
        let mut random = Random::new(size as u64);
        let keys: Vec<u32> = (0..size).map(|_| random.bits() as u32).collect();
        let (counts, input) = (gpu.buffer("counts", &[0, size as u32]), gpu.buffer("keys", &keys));
        let blocks = size.div_ceil(block);
        let words = (blocks << bits) + 2;
        let run_words = blocks * lanes as usize * (1 << bits).max(4) + 2;
        let histogram = gpu.untouched::<u32>("histogram", words);
        let run_counts = gpu.untouched::<u32>("run_counts", run_words);
        let bind = Bind { counts: &counts, keys: &input, histogram: &histogram, run_counts: &run_counts };
        let push = Push { count_index: 1, shift, bits };
        gpu.run(|recorder| recorder.dispatch(&kernel, &bind, &push, blocks as u64 + 1));
        let mut expected = sort_upsweep(&keys, shift, bits, block);
        expected.extend([UNTOUCHED; 2]);
        assert_eq!(gpu.read::<u32>(&histogram, words), expected, "size {size}, {bits} bits at {shift}");
        let mut expected = sort_upsweep_serial(&keys, [shift, bits], run, lanes as usize).concat();
        expected.extend([UNTOUCHED; 2]);
        assert_eq!(gpu.read::<u32>(&run_counts, run_words), expected, "size {size}, {bits} bits at {shift}");
    }
}
