//! Sums of sequences: the twins of `scan/scan_reduce`, `scan/scan_spine` and `scan/scan_apply`.

/// One wrapping sum per block of a sequence.
pub fn scan_reduce(values: &[u32], block: usize) -> Vec<u32> {
    values
        .chunks(block)
        .map(|block| block.iter().fold(0_u32, |sum, value| sum.wrapping_add(*value)))
        .collect()
}

/// Exclusive prefix sum in place, modulo 2^32. Returns the sum of all, at most `u32::MAX`.
pub fn scan_spine(sums: &mut [u32]) -> u32 {
    let mut running = 0_u64;
    for sum in sums {
        let next = running + u64::from(*sum);
        *sum = running as u32;
        running = next;
    }
    running.min(u32::MAX.into()) as u32
}

/// prefix[i] = offset of its block + sum of the values before it in the block.
pub fn scan_apply(values: &[u32], offsets: &[u32], block: usize) -> Vec<u32> {
    let mut prefix = Vec::with_capacity(values.len());
    for (values, &offset) in values.chunks(block).zip(offsets) {
        let mut running = offset;
        for value in values {
            prefix.push(running);
            running = running.wrapping_add(*value);
        }
    }
    prefix
}

/// The whole scan as a plain loop.
pub fn exclusive_scan(values: &[u32]) -> (Vec<u32>, u32) {
    let mut prefix = values.to_vec();
    let total = scan_spine(&mut prefix);
    (prefix, total)
}
