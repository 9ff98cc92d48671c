//! `sort/sort_downsweep` against its twin; the twins do the other two steps of a pass.

use ashsplat::kernels::sort::sort_downsweep::{Bind, Interface, Push, Spec};

use crate::common::gpu::{Gpu, UNTOUCHED, sizes};
use crate::common::keys::equal_and_extreme;
use crate::common::scenes::Random;
use crate::reference::sort_downsweep::sort_downsweep;
use crate::reference::sort_spine::sort_spine;
use crate::reference::sort_upsweep::sort_upsweep;

fn spec(gpu: &Gpu, identity_values: bool) -> Spec {
    Spec {
        workgroup_size: gpu.workgroup(8 * gpu.subgroup()).min(256),
        subgroup_size: gpu.subgroup(),
        items: 4,
        identity_values,
    }
}

/// Scatters by one digit and compares.
fn check(gpu: &Gpu, spec: Spec, keys: &[u32], [shift, bits]: [u32; 2]) {
    let size = keys.len();
    let block = (spec.workgroup_size * spec.items) as usize;
    let blocks = size.div_ceil(block);
    // Values identify their positions, to check the order of equal keys.
    let scale = if spec.identity_values { 1 } else { 3 };
    let values: Vec<u32> = (0..size as u32).map(|place| place * scale).collect();
    let mut histogram = sort_upsweep(keys, shift, bits, block);
    let totals = sort_spine(&mut histogram, blocks, 1 << bits);
    let counts = gpu.buffer("counts", &[size as u32]);
    let input = gpu.buffer("keys", keys);
    let input_values = match spec.identity_values {
        true => gpu.untouched::<u32>("values", size),
        false => gpu.buffer("values", &values),
    };
    let (histogram, totals) = (gpu.buffer("histogram", &histogram), gpu.buffer("digit_totals", &totals));
    let sorted_keys = gpu.untouched::<u32>("sorted_keys", size + 2);
    let sorted_values = gpu.untouched::<u32>("sorted_values", size + 2);
    let bind = Bind {
        counts: &counts,
        keys: &input,
        values: &input_values,
        histogram: &histogram,
        digit_totals: &totals,
        sorted_keys: &sorted_keys,
        sorted_values: &sorted_values,
    };
    let push = Push { count_index: 0, shift, bits };
    gpu.dispatch::<Interface>(&spec, &bind, &push, blocks as u64 + 1);
    let (mut expected_keys, mut expected_values) = sort_downsweep(keys, &values, shift, bits);
    expected_keys.extend([UNTOUCHED; 2]);
    expected_values.extend([UNTOUCHED; 2]);
    let case = format!("size {size}, {bits} bits at {shift}, {spec:?}");
    assert_eq!(gpu.read::<u32>(&sorted_keys, size + 2), expected_keys, "{case}");
    assert_eq!(gpu.read::<u32>(&sorted_values, size + 2), expected_values, "{case}");
}

#[test]
pub fn sort_downsweep_equals_its_twin() {
    let gpu = Gpu::new();
    for identity_values in [false, true] {
        check_sizes(&gpu, spec(&gpu, identity_values));
    }
    // A block of more pairs than its subgroups have digit counts.
    check_sizes(&gpu, Spec { workgroup_size: gpu.subgroup(), items: 128, ..spec(&gpu, false) });
}

/// Key counts around multiples of a block, random keys, all digits.
pub fn check_sizes(gpu: &Gpu, spec: Spec) {
    for size in sizes((spec.workgroup_size * spec.items) as usize) {
        let mut random = Random::new(size as u64);
        let keys: Vec<u32> = (0..size).map(|_| random.bits() as u32).collect();
        for digit in [[0, 8], [24, 8], [8, 5], [31, 1]] {
            check(gpu, spec, &keys, digit);
        }
    }
}

#[test]
pub fn sort_downsweep_of_equal_and_extreme_keys() {
    let gpu = Gpu::new();
    let spec = spec(&gpu, false);
    let size = (3 * spec.workgroup_size * spec.items + 5) as usize;
    for keys in equal_and_extreme(size) {
        check(&gpu, spec, &keys, [0, 8]);
    }
}
