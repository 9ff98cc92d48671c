//! The order of blending, and a stable sort of keys with values.

use super::duplicate_with_tiles::Instance;

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
