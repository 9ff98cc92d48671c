//! Final positions of the keys of each run and digit, the twin of `sort/sort_downsweep_serial` beside
//! [`super::sort_downsweep`].

/// Computes from each run's counts the position after its last key of each digit, ordered by digits, then runs.
pub fn sort_downsweep_serial(counts: &[Vec<u32>], digits: usize) -> Vec<Vec<u32>> {
    let mut ends = counts.to_vec();
    let mut place = 0;
    for digit in 0..digits {
        for end in &mut ends {
            place += end[digit];
            end[digit] = place;
        }
    }
    ends
}
