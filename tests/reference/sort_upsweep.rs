//! Histogram of one digit in each block of keys, the twin of `sort/sort_upsweep`.

/// The digit of a key.
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
