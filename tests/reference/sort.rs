//! The order of blending and stable sorts: the twins of `sort/sort_upsweep`, `sort/sort_upsweep_serial`,
//! `sort/sort_spine`, `sort/sort_downsweep`, `sort/sort_downsweep_serial` and `sort/sort_single_subgroup`.

use super::lists::Instance;
use super::scan::scan_spine;

/// Sorts by tile, then depth bits, then Gaussian (spec: "Forward" 7).
pub fn sort_by_tile_and_depth(instances: &mut [Instance]) {
    instances.sort_by_key(|instance| (instance.tile, instance.depth_bits, instance.gaussian));
}

/// Stable sort of pairs by the low `bits` bits of the key.
pub fn sort_pairs(keys: &[u32], values: &[u32], bits: u32) -> (Vec<u32>, Vec<u32>) {
    let mask = if bits >= 32 { u32::MAX } else { (1 << bits) - 1 };
    let mut pairs: Vec<(u32, u32)> = keys.iter().copied().zip(values.iter().copied()).collect();
    pairs.sort_by_key(|(key, _)| key & mask);
    pairs.into_iter().unzip()
}

pub fn digit(key: u32, shift: u32, bits: u32) -> usize {
    ((key >> shift) & ((1 << bits) - 1)) as usize
}

/// histogram[digit · blocks + block].
pub fn sort_upsweep(keys: &[u32], shift: u32, bits: u32, block: usize) -> Vec<u32> {
    let blocks = keys.len().div_ceil(block);
    let mut histogram = vec![0; blocks << bits];
    for (place, &key) in keys.iter().enumerate() {
        histogram[digit(key, shift, bits) * blocks + place / block] += 1;
    }
    histogram
}

/// run_counts[run · digits + digit], for whole blocks of runs and at least four digits.
pub fn sort_upsweep_serial(
    keys: &[u32],
    [shift, bits]: [u32; 2],
    run: usize,
    runs_per_block: usize,
) -> Vec<Vec<u32>> {
    let runs = keys.len().div_ceil(run * runs_per_block) * runs_per_block;
    let mut counts = vec![vec![0; (1 << bits).max(4)]; runs];
    for (place, &key) in keys.iter().enumerate() {
        counts[place / run][digit(key, shift, bits)] += 1;
    }
    counts
}

/// Exclusive prefix sum of each digit's row of the histogram, in place; returns each digit's total.
pub fn sort_spine(histogram: &mut [u32], blocks: usize, digits: usize) -> Vec<u32> {
    (0..digits).map(|digit| scan_spine(&mut histogram[digit * blocks..(digit + 1) * blocks])).collect()
}

/// Keys and values, ordered by digit, then by position.
pub fn sort_downsweep(keys: &[u32], values: &[u32], shift: u32, bits: u32) -> (Vec<u32>, Vec<u32>) {
    let (mut sorted_keys, mut sorted_values) = (Vec::new(), Vec::new());
    for wanted in 0..1 << bits {
        for (&key, &value) in keys.iter().zip(values) {
            if digit(key, shift, bits) == wanted {
                sorted_keys.push(key);
                sorted_values.push(value);
            }
        }
    }
    (sorted_keys, sorted_values)
}

/// Computes from each run's counts the position after its last key of each digit, ordered by digits, then runs.
pub fn sort_downsweep_serial(counts: &[Vec<u32>], digits: usize) -> Vec<Vec<u32>> {
    let mut ends = counts.to_vec();
    let mut place = 0;
    for digit in 0..digits {
        for end in &mut ends {
            place += end[digit];
            end[digit] = place;
        }
    }
    ends
}

/// The pairs after `passes` passes over digits of `digit_bits` bits, from the lowest one up.
pub fn sort_single_subgroup(
    keys: &[u32],
    values: &[u32],
    digit_bits: u32,
    passes: u32,
) -> (Vec<u32>, Vec<u32>) {
    (0..passes).fold((keys.to_vec(), values.to_vec()), |(keys, values), pass| {
        sort_downsweep(&keys, &values, pass * digit_bits, digit_bits)
    })
}
