//! Exclusive prefix sum of the block sums, the twin of `scan/scan_spine`.

/// In place; returns the sum of all.
pub fn scan_spine(sums: &mut [u32]) -> u32 {
    let mut running = 0_u32;
    for sum in sums {
        let next = running.wrapping_add(*sum);
        *sum = running;
        running = next;
    }
    running
}
