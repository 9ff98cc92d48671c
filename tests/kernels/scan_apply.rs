//! `scan/scan_apply` against its twin, alone and after the other two steps.

use ashsplat::kernels::scan::{scan_apply, scan_reduce, scan_spine};

use crate::common::gpu::{Gpu, UNTOUCHED, sizes};
use crate::common::scenes::Random;
use crate::reference::scan_apply::{exclusive_scan, scan_apply};

#[test]
pub fn scan_apply_equals_its_twin() {
    let gpu = Gpu::new();
    check(
        &gpu,
        scan_apply::Spec { workgroup_size: gpu.workgroup(64), subgroup_size: gpu.subgroup(), items: 4 },
    );
    // A single subgroup needs no barrier.
    check(
        &gpu,
        scan_apply::Spec { workgroup_size: gpu.subgroup(), subgroup_size: gpu.subgroup(), items: 12 },
    );
}

fn check(gpu: &Gpu, spec: scan_apply::Spec) {
    let block = (spec.workgroup_size * spec.items) as usize;
    for size in sizes(block) {
        let mut random = Random::new(size as u64);
        let values: Vec<u32> = (0..size).map(|_| random.bits() as u32).collect();
        let blocks = size.div_ceil(block);
        let offsets: Vec<u32> = (0..blocks).map(|_| random.bits() as u32).collect();
        let counts = gpu.buffer("counts", &[size as u32]);
        let (input, block_offsets) = (gpu.buffer("values", &values), gpu.buffer("block_offsets", &offsets));
        let prefix = gpu.untouched::<u32>("prefix", size + 2);
        let bind = scan_apply::Bind {
            counts: &counts,
            values: &input,
            block_offsets: &block_offsets,
            prefix: &prefix,
        };
        let push = scan_apply::Push { count_index: 0 };
        gpu.dispatch::<scan_apply::Interface>(&spec, &bind, &push, blocks as u64 + 1);
        let mut expected = scan_apply(&values, &offsets, block);
        expected.extend([UNTOUCHED; 2]);
        assert_eq!(gpu.read::<u32>(&prefix, size + 2), expected, "size {size}");
    }
}

/// The three steps with the smallest blocks, so that the workgroups exceed one axis of the grid.
#[test]
fn scan_of_more_than_65535_workgroups() {
    let gpu = Gpu::new();
    let (workgroup_size, subgroup_size) = (gpu.subgroup(), gpu.subgroup());
    let reduce = gpu.kernel(&scan_reduce::Spec { workgroup_size, subgroup_size, items: 4 });
    let reduce: &ashsplat::vk::Kernel<scan_reduce::Interface> = &reduce;
    let spine = gpu.kernel::<scan_spine::Interface>(&scan_spine::Spec {
        items: 1,
        workgroup_size: gpu.workgroup(256),
        subgroup_size,
    });
    let apply =
        gpu.kernel::<scan_apply::Interface>(&scan_apply::Spec { workgroup_size, subgroup_size, items: 4 });
    let block = workgroup_size * 4;
    let size = 65_540 * block - 3;
    let blocks = u64::from(size.div_ceil(block));
    let mut random = Random::new(1);
    let values: Vec<u32> = (0..size).map(|_| random.below(1 << 10)).collect();
    let counts = gpu.buffer("counts", &[size]);
    let totals = gpu.buffer("totals", &[0]);
    let input = gpu.buffer("values", &values);
    let sums = gpu.untouched::<u32>("sums", blocks as usize);
    let prefix = gpu.untouched::<u32>("prefix", size as usize);
    gpu.run(|recorder| {
        let bind = scan_reduce::Bind { counts: &counts, values: &input, block_sums: &sums };
        recorder.dispatch(reduce, &bind, &scan_reduce::Push { count_index: 0 }, blocks);
        recorder.barrier();
        let bind = scan_spine::Bind { block_sums: &sums, totals: &totals };
        let push =
            scan_spine::Push { count: size, from_totals: 0, block_size: block, total_index: 0, first_sum: 0 };
        recorder.dispatch(&spine, &bind, &push, 1);
        recorder.barrier();
        let bind =
            scan_apply::Bind { counts: &counts, values: &input, block_offsets: &sums, prefix: &prefix };
        recorder.dispatch(&apply, &bind, &scan_apply::Push { count_index: 0 }, blocks);
    });
    let (expected, total) = exclusive_scan(&values);
    assert!(gpu.read::<u32>(&prefix, size as usize) == expected, "the prefix sums differ");
    assert_eq!(gpu.read::<u32>(&totals, 1), [total]);
}
