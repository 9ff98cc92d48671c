//! Histograms of one digit in each run of keys, the twin of `sort/sort_upsweep_serial` beside [`super::sort_upsweep`].

use super::sort_upsweep::digit;

/// run_counts[run · digits + digit], for whole blocks of runs and at least four digits.
pub fn sort_upsweep_serial(
    keys: &[u32],
    [shift, bits]: [u32; 2],
    run: usize,
    runs_per_block: usize,
) -> Vec<Vec<u32>> {
    let runs = keys.len().div_ceil(run * runs_per_block) * runs_per_block;
    let mut counts = vec![vec![0; (1 << bits).max(4)]; runs];
    for (place, &key) in keys.iter().enumerate() {
        counts[place / run][digit(key, shift, bits)] += 1;
    }
    counts
}
