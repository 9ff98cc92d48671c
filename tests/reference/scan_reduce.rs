//! Sum of each block of a sequence, the twin of `scan/scan_reduce`.

/// One wrapping sum per block.
pub fn scan_reduce(values: &[u32], block: usize) -> Vec<u32> {
    values
        .chunks(block)
        .map(|block| block.iter().fold(0_u32, |sum, value| sum.wrapping_add(*value)))
        .collect()
}
