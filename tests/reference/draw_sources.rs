//! Sources of a new set, drawn in proportion to weights; the twin of `densify/draw_sources`.

/// Returns source and kind (0: kept, 1: copy) of each row, and the number of draws of each Gaussian. `bits` gives a
/// row's random word.
pub fn draw(weights: &[u32], rows: usize, bits: impl Fn(usize) -> u32) -> (Vec<(usize, u32)>, Vec<u32>) {
    let total: u64 = weights.iter().map(|&w| u64::from(w)).sum();
    let mut draws = vec![0; weights.len()];
    let sources = (0..rows).map(|row| {
        if total == 0 || weights.get(row).is_some_and(|&weight| weight > 0) {
            return (row.min(weights.len() - 1), 0);
        }
        let place = (u64::from(bits(row)) * total) >> 32;
        // Number of inclusive sums up to the place.
        let mut sum = 0;
        let passed = weights.iter().take_while(|&&weight| {
            sum += u64::from(weight);
            sum <= place
        });
        let source = passed.count();
        draws[source] += 1;
        (source, 1)
    });
    (sources.collect(), draws)
}
