//! Exclusive prefix sum of each digit's row of the histogram, the twin of `sort/sort_spine`.

use super::scan_spine::scan_spine;

/// Works in place; returns each digit's total.
pub fn sort_spine(histogram: &mut [u32], blocks: usize, digits: usize) -> Vec<u32> {
    (0..digits).map(|digit| scan_spine(&mut histogram[digit * blocks..(digit + 1) * blocks])).collect()
}
