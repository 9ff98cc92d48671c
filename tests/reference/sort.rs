//! The order of blending and stable sorts: the twins of `sort/sort_upsweep`, `sort/sort_spine` and
//! `sort/sort_downsweep`.

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

/// Rows of numbers of keys by digit: per block, in the earlier blocks of its group of `per_group` blocks; per group, in earlier
/// groups; in all. Empty without keys.
pub fn sort_upsweep(keys: &[u32], shift: u32, bits: u32, block: usize, per_group: usize) -> Vec<u32> {
    let mut blocks = vec![vec![0; 1 << bits]; keys.len().div_ceil(block)];
    for (place, &key) in keys.iter().enumerate() {
        blocks[place / block][digit(key, shift, bits)] += 1;
    }
    let mut groups: Vec<Vec<u32>> = blocks.chunks_mut(per_group).map(scan_rows).collect();
    let all = if groups.is_empty() { Vec::new() } else { scan_rows(&mut groups) };
    [blocks, groups, vec![all]].concat().concat()
}

/// Replaces rows by the sums of those before, and returns the sums of all.
fn scan_rows(rows: &mut [Vec<u32>]) -> Vec<u32> {
    let mut sums = vec![0; rows[0].len()];
    for row in rows {
        for (sum, keys) in sums.iter_mut().zip(row) {
            (*sum, *keys) = (*sum + *keys, *sum);
        }
    }
    sums
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
