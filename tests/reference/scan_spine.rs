//! Exclusive prefix sum of the block sums, the twin of `scan/scan_spine`.

/// Works in place, modulo 2^32. Returns the sum of all, at most `u32::MAX`.
pub fn scan_spine(sums: &mut [u32]) -> u32 {
    let mut running = 0_u64;
    for sum in sums {
        let next = running + u64::from(*sum);
        *sum = running as u32;
        running = next;
    }
    running.min(u32::MAX.into()) as u32
}
