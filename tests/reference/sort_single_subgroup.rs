//! A stable sort digit by digit, the twin of `sort/sort_single_subgroup`.

use super::sort_downsweep::sort_downsweep;

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
