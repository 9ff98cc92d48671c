//! `sort/sort_single_subgroup` against its twin.

use ashsplat::kernels::sort::sort_single_subgroup::{Bind, Interface, Push, Spec};
use ashsplat::vk::Kernel;

use crate::common::gpu::{Gpu, UNTOUCHED, sizes};
use crate::common::scenes::Random;
use crate::reference::sort_single_subgroup::sort_single_subgroup;

fn spec(gpu: &Gpu, identity_values: bool) -> Spec {
    Spec { workgroup_size: gpu.subgroup(), subgroup_size: gpu.subgroup(), identity_values }
}

/// Sorts and compares the pairs, and checks that nothing behind them changes.
fn check(gpu: &Gpu, kernel: &Kernel<Interface>, spec: Spec, keys: &[u32], [digit_bits, passes]: [u32; 2]) {
    let size = keys.len();
    let scale = if spec.identity_values { 1 } else { 3 };
    let values: Vec<u32> = (0..size as u32).map(|place| place * scale).collect();
    let padded = |words: &[u32]| [words, &[UNTOUCHED; 2]].concat();
    let counts = gpu.buffer("counts", &[7, size as u32]);
    let values_a = match spec.identity_values {
        true => gpu.untouched::<u32>("values_a", size + 2),
        false => gpu.buffer("values_a", &padded(&values)),
    };
    let [keys_a, keys_b] = [gpu.buffer("keys_a", &padded(keys)), gpu.untouched::<u32>("keys_b", size + 2)];
    let values_b = gpu.untouched::<u32>("values_b", size + 2);
    let run_words = spec.subgroup_size as usize * (1 << digit_bits).max(4);
    let run_counts = gpu.untouched::<u32>("run_counts", run_words + 1);
    let bind = Bind {
        counts: &counts,
        keys_a: &keys_a,
        values_a: &values_a,
        keys_b: &keys_b,
        values_b: &values_b,
        run_counts: &run_counts,
    };
    let push = Push { count_index: 1, digit_bits, passes };
    gpu.run(|recorder| recorder.dispatch(kernel, &bind, &push, 1));
    let label = format!("size {size}, {passes} passes of {digit_bits} bits");
    let (expected_keys, expected_values) = sort_single_subgroup(keys, &values, digit_bits, passes);
    let [sorted_keys, sorted_values] =
        if passes.is_multiple_of(2) { [&keys_a, &values_a] } else { [&keys_b, &values_b] };
    assert_eq!(gpu.read::<u32>(sorted_keys, size + 2), padded(&expected_keys), "{label}");
    assert_eq!(gpu.read::<u32>(sorted_values, size + 2), padded(&expected_values), "{label}");
    assert_eq!(gpu.read::<u32>(&run_counts, run_words + 1)[run_words], UNTOUCHED, "{label}");
}

#[test]
fn sort_single_subgroup_equals_its_twin() {
    let gpu = Gpu::new();
    for identity_values in [false, true] {
        let spec = spec(&gpu, identity_values);
        let kernel = gpu.kernel::<Interface>(&spec);
        for size in sizes(4 * spec.subgroup_size as usize).into_iter().chain([3, 4, 5, 1003]) {
            let mut random = Random::new(size as u64);
            let keys: Vec<u32> = (0..size).map(|_| random.bits() as u32).collect();
            for digits in [[8, 4], [10, 1], [10, 3], [5, 2], [1, 1], [1, 3]] {
                check(&gpu, &kernel, spec, &keys, digits);
            }
        }
    }
}

#[test]
fn sort_single_subgroup_of_equal_and_extreme_keys() {
    let gpu = Gpu::new();
    let spec = spec(&gpu, false);
    let kernel = gpu.kernel::<Interface>(&spec);
    let size = 501;
    for key in [0, 0x0101_0101, u32::MAX] {
        check(&gpu, &kernel, spec, &vec![key; size], [8, 4]);
    }
    let turns: Vec<u32> = (0..size as u32).map(|i| if i % 2 == 0 { u32::MAX } else { 0 }).collect();
    let halves: Vec<u32> = (0..size).map(|i| if i < size / 2 { u32::MAX } else { 0 }).collect();
    check(&gpu, &kernel, spec, &turns, [8, 4]);
    check(&gpu, &kernel, spec, &halves, [8, 4]);
}
