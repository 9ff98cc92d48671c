//! Where the keys of each run and digit end up, the twin of `sort/sort_downsweep_serial` beside [`super::sort_downsweep`].

/// From each run's counts: the place behind its last key of each digit, in the order of digits, then runs.
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
