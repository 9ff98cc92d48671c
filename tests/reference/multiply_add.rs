//! Chains of multiply-adds, the twin of `arithmetic/multiply_add`.

/// The sum of one invocation's chains after `steps` steps each.
pub fn multiply_add(invocation: u32, chains: u32, steps: u32, factor: f64, term: f64) -> f64 {
    let chain = |c: u32| (0..steps).fold(f64::from(invocation % 256 + c), |x, _| x * factor + term);
    (0..chains).map(chain).sum()
}
