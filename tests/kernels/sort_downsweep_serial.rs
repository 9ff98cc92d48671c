//! `sort/sort_downsweep_serial` against its twin; the twins do the other two steps of a pass.

use ashsplat::kernels::sort::sort_downsweep_serial::{Bind, Interface, Push, Spec};
use ashsplat::vk::Kernel;

use crate::common::gpu::{Gpu, UNTOUCHED, sizes};
use crate::common::keys::equal_and_extreme;
use crate::common::scenes::Random;
use crate::reference::sort_downsweep::sort_downsweep;
use crate::reference::sort_downsweep_serial::sort_downsweep_serial;
use crate::reference::sort_spine::sort_spine;
use crate::reference::sort_upsweep::sort_upsweep;
use crate::reference::sort_upsweep_serial::sort_upsweep_serial;

fn spec(gpu: &Gpu, identity_values: bool) -> Spec {
    let lanes = gpu.subgroup();
    Spec { workgroup_size: lanes, subgroup_size: lanes, items: 12, identity_values }
}

/// Scatters by one digit and compares.
fn check(gpu: &Gpu, kernel: &Kernel<Interface>, spec: Spec, keys: &[u32], [shift, bits]: [u32; 2]) {
    let size = keys.len();
    let (lanes, run) = (spec.workgroup_size as usize, spec.items as usize);
    let blocks = size.div_ceil(lanes * run);
    // Values identify their positions, to check the order of equal keys.
    let scale = if spec.identity_values { 1 } else { 3 };
    let values: Vec<u32> = (0..size as u32).map(|place| place * scale).collect();
    let mut histogram = sort_upsweep(keys, shift, bits, lanes * run);
    let totals = sort_spine(&mut histogram, blocks, 1 << bits);
    let counts_of_runs = sort_upsweep_serial(keys, [shift, bits], run, lanes);
    let counts = gpu.buffer("counts", &[size as u32]);
    let input = gpu.buffer("keys", keys);
    let input_values = match spec.identity_values {
        true => gpu.untouched::<u32>("values", size),
        false => gpu.buffer("values", &values),
    };
    let (histogram, totals) = (gpu.buffer("histogram", &histogram), gpu.buffer("digit_totals", &totals));
    let run_counts = gpu.buffer("run_counts", &counts_of_runs.concat());
    let [sorted_keys, sorted_values] =
        ["sorted_keys", "sorted_values"].map(|name| gpu.untouched::<u32>(name, size + 2));
    let bind = Bind {
        counts: &counts,
        keys: &input,
        values: &input_values,
        histogram: &histogram,
        digit_totals: &totals,
        run_counts: &run_counts,
        sorted_keys: &sorted_keys,
        sorted_values: &sorted_values,
    };
    let push = Push { count_index: 0, shift, bits };
    gpu.run(|recorder| recorder.dispatch(kernel, &bind, &push, blocks as u64 + 1));
    let label = format!("size {size}, {bits} bits at {shift}");
    let (expected_keys, expected_values) = sort_downsweep(keys, &values, shift, bits);
    let mut read = gpu.read::<u32>(&sorted_keys, size + 2);
    assert_eq!(read.split_off(size), [UNTOUCHED; 2], "{label}");
    assert_eq!(read, expected_keys, "{label}");
    let mut read = gpu.read::<u32>(&sorted_values, size + 2);
    assert_eq!(read.split_off(size), [UNTOUCHED; 2], "{label}");
    assert_eq!(read, expected_values, "{label}");
    // The kernel turns the runs' counts into the positions after their last keys.
    let digits = 1 << bits;
    let ends = sort_downsweep_serial(&counts_of_runs, digits);
    let read = gpu.read::<u32>(&run_counts, ends.concat().len());
    for (read, end) in read.chunks(digits.max(4)).zip(ends) {
        assert_eq!(read[..digits], end[..digits], "{label}");
    }
}

#[test]
fn sort_downsweep_serial_equals_its_twin() {
    let gpu = Gpu::new();
    for identity_values in [false, true] {
        let spec = spec(&gpu, identity_values);
        let kernel = gpu.kernel::<Interface>(&spec);
        let run = spec.items as usize;
        let sizes = sizes(spec.workgroup_size as usize * run);
        for size in sizes.into_iter().chain([3, 4, 5, run - 1, run, run + 1, 2 * run + 7]) {
            let mut random = Random::new(size as u64);
            let keys: Vec<u32> = (0..size).map(|_| random.bits() as u32).collect();
            for digit in [[0, 8], [24, 8], [8, 5], [31, 1], [3, 10]] {
                check(&gpu, &kernel, spec, &keys, digit);
            }
        }
    }
}

#[test]
fn sort_downsweep_serial_of_equal_and_extreme_keys() {
    let gpu = Gpu::new();
    let spec = spec(&gpu, false);
    let kernel = gpu.kernel::<Interface>(&spec);
    let size = (3 * spec.workgroup_size * spec.items + 5) as usize;
    for keys in equal_and_extreme(size) {
        check(&gpu, &kernel, spec, &keys, [0, 8]);
    }
}
