//! Stable order by one digit, the twin of `sort/sort_downsweep`.

use super::sort_upsweep::digit;

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
