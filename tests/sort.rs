//! The whole radix sort with every method: order, permutation and stability.

use crate::common::prelude::*;
use crate::reference::sort::sort_pairs;
use ashsplat::frame::{LaunchSizes, SORT_ARRIVAL_BYTES, SortMethod};
use ashsplat::passes::scan::Workgroups;
use ashsplat::passes::sort::{RadixSort, SortBuffers, Values};

/// The sort by matching, by runs, and by runs with a single workgroup for few pairs.
fn sorts(gpu: &Gpu) -> [RadixSort; 3] {
    let methods = [(SortMethod::Matching, false), (SortMethod::Serial, false), (SortMethod::Serial, true)];
    methods.map(|(method, sort_single_subgroup)| {
        let sizes = LaunchSizes {
            sort_single_subgroup,
            ..LaunchSizes::with_sort_method(gpu.context.limits(), method)
        };
        RadixSort::with_sizes(gpu.context, sizes).expect("the kernels of the sort")
    })
}

fn sorted(
    gpu: &Gpu,
    sort: &RadixSort,
    keys: &[u32],
    values: Option<&[u32]>,
    bits: u32,
) -> (Vec<u32>, Vec<u32>) {
    let n = keys.len();
    // Elements after the pairs must not change.
    let padded = |words: &[u32]| [words, &[UNTOUCHED; 3]].concat();
    let counts = gpu.buffer("counts", &[99, n as u32]);
    let keys = [gpu.buffer("keys_a", &padded(keys)), gpu.untouched::<u32>("keys_b", n + 3)];
    let values_a = match values {
        Some(values) => gpu.buffer("values_a", &padded(values)),
        None => gpu.untouched::<u32>("values_a", n + 3),
    };
    let values_of = [values_a, gpu.untouched::<u32>("values_b", n + 3)];
    let histogram =
        gpu.untouched::<u32>("histogram", sort.sizes.sort_histogram_words(n as u64 + 3, bits) as usize);
    let digit_totals = gpu.untouched::<u32>("digit_totals", sort.digit_total_words() as usize);
    let zeros = [0_u8; SORT_ARRIVAL_BYTES as usize];
    let arrivals = gpu.buffer("arrivals", &zeros);
    let buffers = SortBuffers {
        counts: &counts,
        count_index: 1,
        keys: [&keys[0], &keys[1]],
        values: [&values_of[0], &values_of[1]],
        histogram: &histogram,
        digit_totals: &digit_totals,
        arrivals: &arrivals,
    };
    let order = if values.is_some() { Values::Given } else { Values::Positions };
    let mut end = 0;
    gpu.run(|recorder| end = sort.record(recorder, &buffers, order, bits, Workgroups::Elements(n as u64)));
    assert_eq!(gpu.read::<u8>(&arrivals, zeros.len()), zeros);
    let take = |buffer| {
        let mut words = gpu.read::<u32>(buffer, n + 3);
        assert_eq!(words.split_off(n), [UNTOUCHED; 3]);
        words
    };
    (take(&keys[end]), take(&values_of[end]))
}

fn check(gpu: &Gpu, sort: &RadixSort, keys: &[u32], bits: u32) {
    let n = keys.len();
    // Values in descending order: a stable sort keeps it among equal keys, an unstable one hardly by chance.
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
    for sort in sorts(&gpu) {
        let block = sort.sizes.sort_block as usize;
        let run = LaunchSizes::with_sort_method(gpu.context.limits(), SortMethod::Serial).sort_items as usize;
        let sizes = [0, 1, 2, 3, 4, 5, 31, 32, 33, run - 1, run, run + 1, 20_000];
        let of_blocks = [block - 1, block, block + 1, 2 * block - 1, 5 * block + 77];
        for n in sizes.into_iter().chain(of_blocks) {
            let mut random = Random::new(n as u64);
            let keys: Vec<u32> = (0..n).map(|_| random.bits() as u32).collect();
            check(&gpu, &sort, &keys, 32);
        }
    }
}

/// With short runs, whose block is as small as the other method's.
#[test]
fn sort_of_sizes_across_one_block() {
    let gpu = Gpu::with(&ContextOptions { overrides: vec![sort_constant("ITEMS", 16)], ..options() });
    for sort in sorts(&gpu) {
        let mut random = Random::new(1);
        let block = sort.sizes.sort_block;
        for n in (0..=block + 1).filter(|n| *n < 70 || n % 13 == 0 || n + 34 > block) {
            // Few distinct keys, so that stability matters; one pass reveals a wrong size.
            let keys: Vec<u32> = (0..n).map(|_| random.below(40)).collect();
            let positions: Vec<u32> = (0..n).collect();
            let expected = sort_pairs(&keys, &positions, 6);
            assert!(sorted(&gpu, &sort, &keys, None, 6) == expected, "{n} keys");
        }
    }
}

fn sort_constant(constant: &str, bits: u32) -> SpecOverride {
    SpecOverride { kernel: "sort".into(), constant: constant.into(), bits }
}

#[test]
fn sort_of_special_keys() {
    let gpu = Gpu::new();
    for sort in sorts(&gpu) {
        let n = 3 * sort.sizes.sort_block as usize + 5;
        for key in [0, 7, u32::MAX] {
            check(&gpu, &sort, &vec![key; n], 32);
        }
        let alternating = (0..n as u32).map(|i| if i % 2 == 0 { u32::MAX } else { 0 }).collect();
        let halves = (0..n).map(|i| if i < n / 2 { u32::MAX } else { 0 }).collect();
        let keys: [Vec<u32>; 4] =
            [(0..n as u32).collect(), (0..n as u32).rev().collect(), alternating, halves];
        keys.iter().for_each(|keys| check(&gpu, &sort, keys, 32));
    }
}

#[test]
fn sort_of_keys_of_few_bits() {
    let gpu = Gpu::new();
    for sort in sorts(&gpu) {
        for bits in 1..=31 {
            let mut random = Random::new(bits.into());
            let keys: Vec<u32> = (0..3000).map(|_| random.bits() as u32 >> (32 - bits)).collect();
            check(&gpu, &sort, &keys, bits);
        }
    }
}

#[test]
fn sort_in_a_narrow_grid() {
    let limits = LimitsOverride { max_workgroups_per_axis: Some(5), ..LimitsOverride::default() };
    let gpu = Gpu::with(&ContextOptions { limits_override: Some(limits), ..options() });
    // The histogram scan has one workgroup per digit: with wide blocks more than the 25 of a 5 × 5 grid.
    for sort in sorts(&gpu) {
        let mut random = Random::new(4);
        let keys: Vec<u32> = (0..23 * sort.sizes.sort_block).map(|_| random.below(8)).collect();
        check(&gpu, &sort, &keys, 3);
    }
}

#[test]
fn sort_of_more_than_65535_workgroups() {
    let overrides = vec![sort_constant("WORKGROUP_SIZE", 1), sort_constant("ITEMS", 1)];
    let gpu = Gpu::with(&ContextOptions { overrides, ..options() });
    for sort in sorts(&gpu) {
        let n = 65_540 * sort.sizes.sort_block - 3;
        let bits = 3;
        let mut random = Random::new(2);
        let keys: Vec<u32> = (0..n).map(|_| random.below(1 << bits)).collect();
        let positions: Vec<u32> = (0..n).collect();
        let (keys_out, values_out) = sorted(&gpu, &sort, &keys, None, bits);
        let (expected_keys, expected_values) = sort_pairs(&keys, &positions, bits);
        assert!(keys_out == expected_keys, "the keys are out of order");
        assert!(values_out == expected_values, "the sort is not stable");
    }
}
