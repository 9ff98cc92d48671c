//! Exclusive prefix sum within each block plus the block's offset, the twin of `scan/scan_apply`.

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
    let total = super::scan_spine::scan_spine(&mut prefix);
    (prefix, total)
}
