//! The radix sort as a whole: order, permutation and stability.

use ashsplat::kernels::sort::{sort_count, sort_scan, sort_scatter};
use ashsplat::scan::Workgroups;
use ashsplat::sort::{RadixSort, SortBuffers, Values};
use ashsplat::vk::{Context, ContextOptions, Kernel, LimitsOverride};

use crate::common::gpu::{Gpu, UNTOUCHED};
use crate::common::options;
use crate::common::scenes::Random;
use crate::reference::sort::sort_pairs;

/// Sorts pairs on the device.
fn sorted(
    gpu: &Gpu,
    sort: &RadixSort,
    keys: &[u32],
    values: Option<&[u32]>,
    bits: u32,
) -> (Vec<u32>, Vec<u32>) {
    let n = keys.len();
    // What lies behind the pairs must stay as it is.
    let padded = |words: &[u32]| [words, &[UNTOUCHED; 3]].concat();
    let counts = gpu.buffer("counts", &[99, n as u32]);
    let keys = [gpu.buffer("keys_a", &padded(keys)), gpu.untouched::<u32>("keys_b", n + 3)];
    let values_a = match values {
        Some(values) => gpu.buffer("values_a", &padded(values)),
        None => gpu.untouched::<u32>("values_a", n + 3),
    };
    let values_of = [values_a, gpu.untouched::<u32>("values_b", n + 3)];
    let histogram = gpu.untouched::<u32>("histogram", sort.histogram_words(n as u64) as usize);
    let digit_totals = gpu.untouched::<u32>("digit_totals", 256);
    let buffers = SortBuffers {
        counts: &counts,
        count_index: 1,
        keys: [&keys[0], &keys[1]],
        values: [&values_of[0], &values_of[1]],
        histogram: &histogram,
        digit_totals: &digit_totals,
    };
    let order = if values.is_some() { Values::Given } else { Values::Positions };
    let mut end = 0;
    gpu.run(|recorder| end = sort.record(recorder, &buffers, order, bits, Workgroups::Elements(n as u64)));
    let take = |buffer| {
        let mut words = gpu.read::<u32>(buffer, n + 3);
        assert_eq!(words.split_off(n), [UNTOUCHED; 3]);
        words
    };
    (take(&keys[end]), take(&values_of[end]))
}

fn check(gpu: &Gpu, sort: &RadixSort, keys: &[u32], bits: u32) {
    let n = keys.len();
    // Values in descending order: a stable sort keeps that among equal keys, an unstable one hardly by chance.
    let values: Vec<u32> = (0..n as u32).rev().collect();
    let expected = sort_pairs(keys, &values, bits);
    assert!(sorted(gpu, sort, keys, Some(&values), bits) == expected, "{n} pairs, {bits} bits");
    let positions: Vec<u32> = (0..n as u32).collect();
    let expected = sort_pairs(keys, &positions, bits);
    assert!(sorted(gpu, sort, keys, None, bits) == expected, "{n} positions, {bits} bits");
}

#[test]
fn sort_of_many_sizes() {
    let gpu = Gpu::new();
    let sort = RadixSort::new(gpu.context).expect("the kernels of the sort");
    let block = sort.block() as usize;
    let sizes = [0, 1, 2, 31, 32, 33, block - 1, block, block + 1, 2 * block - 1, 5 * block + 77, 20_000];
    for n in sizes {
        let mut random = Random::new(n as u64);
        let keys: Vec<u32> = (0..n).map(|_| random.bits() as u32).collect();
        check(&gpu, &sort, &keys, 32);
    }
}

#[test]
fn sort_of_every_size_across_one_block() {
    let gpu = Gpu::new();
    let sort = RadixSort::new(gpu.context).expect("the kernels of the sort");
    let block = sort.block();
    let mut random = Random::new(1);
    for n in 0..=block + 1 {
        // Few distinct keys, so that stability counts; one pass suffices to see a size that goes wrong.
        let keys: Vec<u32> = (0..n).map(|_| random.below(40)).collect();
        let positions: Vec<u32> = (0..n).collect();
        let expected = sort_pairs(&keys, &positions, 6);
        assert!(sorted(&gpu, &sort, &keys, None, 6) == expected, "{n} keys");
    }
}

#[test]
fn sort_of_special_keys() {
    let gpu = Gpu::new();
    let sort = RadixSort::new(gpu.context).expect("the kernels of the sort");
    let n = 3 * sort.block() as usize + 5;
    for key in [0, 7, u32::MAX] {
        check(&gpu, &sort, &vec![key; n], 32);
    }
    let ascending: Vec<u32> = (0..n as u32).collect();
    let descending: Vec<u32> = (0..n as u32).rev().collect();
    let alternating: Vec<u32> = (0..n as u32).map(|i| if i % 2 == 0 { u32::MAX } else { 0 }).collect();
    for keys in [ascending, descending, alternating] {
        check(&gpu, &sort, &keys, 32);
    }
}

#[test]
fn sort_of_keys_of_few_bits() {
    let gpu = Gpu::new();
    let sort = RadixSort::new(gpu.context).expect("the kernels of the sort");
    for bits in 1..=31 {
        let mut random = Random::new(bits.into());
        let keys: Vec<u32> = (0..3000).map(|_| random.bits() as u32 >> (32 - bits)).collect();
        check(&gpu, &sort, &keys, bits);
    }
}

/// The same through a two-dimensional grid of workgroups.
#[test]
fn sort_in_a_narrow_grid() {
    let limits = LimitsOverride { max_workgroups_per_axis: Some(5), ..LimitsOverride::default() };
    let narrow = ContextOptions { limits_override: Some(limits), ..options() };
    let gpu = Gpu { context: Box::leak(Box::new(Context::new(&narrow).expect("a device"))) };
    // The scan of the histogram is one dispatch of a row per digit: more workgroups than 5 × 5 allow on wide blocks.
    let Ok(sort) = RadixSort::new(gpu.context) else { panic!("the kernels of the sort") };
    let mut random = Random::new(4);
    let keys: Vec<u32> = (0..23 * sort.block()).map(|_| random.below(8)).collect();
    check(&gpu, &sort, &keys, 3);
}

/// One pass with the smallest blocks: more workgroups than one axis of a grid holds.
#[test]
fn sort_of_more_than_65535_workgroups() {
    let gpu = Gpu::new();
    let (workgroup_size, subgroup_size) = (gpu.subgroup(), gpu.subgroup());
    let count: Kernel<sort_count::Interface> = gpu.kernel(&sort_count::Spec { workgroup_size, items: 1 });
    let scan: Kernel<sort_scan::Interface> =
        gpu.kernel(&sort_scan::Spec { workgroup_size: gpu.workgroup(64), subgroup_size });
    let scatter: Kernel<sort_scatter::Interface> =
        gpu.kernel(&sort_scatter::Spec { workgroup_size, subgroup_size, items: 1, identity_values: true });
    let n = 65_540 * workgroup_size - 3;
    let blocks = u64::from(n.div_ceil(workgroup_size));
    let bits = 3;
    let mut random = Random::new(2);
    let keys: Vec<u32> = (0..n).map(|_| random.below(1 << bits)).collect();
    let (counts, input) = (gpu.buffer("counts", &[n]), gpu.buffer("keys", &keys));
    let histogram = gpu.untouched::<u32>("histogram", (blocks as usize) << bits);
    let digit_totals = gpu.untouched::<u32>("digit_totals", 1 << bits);
    let [sorted_keys, sorted_values] =
        ["sorted_keys", "sorted_values"].map(|name| gpu.untouched::<u32>(name, n as usize));
    gpu.run(|recorder| {
        let bind = sort_count::Bind { counts: &counts, keys: &input, histogram: &histogram };
        recorder.dispatch(&count, &bind, &sort_count::Push { count_index: 0, shift: 0, bits }, blocks);
        recorder.barrier();
        let bind = sort_scan::Bind { counts: &counts, histogram: &histogram, digit_totals: &digit_totals };
        let push = sort_scan::Push { count_index: 0, block_size: workgroup_size, digits: 1 << bits };
        recorder.dispatch(&scan, &bind, &push, 1 << bits);
        recorder.barrier();
        let bind = sort_scatter::Bind {
            counts: &counts,
            keys: &input,
            values: &counts,
            histogram: &histogram,
            digit_totals: &digit_totals,
            sorted_keys: &sorted_keys,
            sorted_values: &sorted_values,
        };
        recorder.dispatch(&scatter, &bind, &sort_scatter::Push { count_index: 0, shift: 0, bits }, blocks);
    });
    let positions: Vec<u32> = (0..n).collect();
    let (expected_keys, expected_values) = sort_pairs(&keys, &positions, bits);
    assert!(gpu.read::<u32>(&sorted_keys, n as usize) == expected_keys, "the keys are out of order");
    assert!(gpu.read::<u32>(&sorted_values, n as usize) == expected_values, "the sort is not stable");
}
