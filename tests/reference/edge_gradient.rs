//! Edge responses scaled to [0, 1]: the twin of `densify/edge_gradient`.

/// Maps the smallest response to 0 and the largest to 1; 0 if all are equal.
pub fn edges(responses: &[i64]) -> Vec<f64> {
    let low = responses.iter().copied().min().unwrap_or(0);
    let high = responses.iter().copied().max().unwrap_or(0);
    let span = if high > low { (high - low) as f64 } else { f64::INFINITY };
    responses.iter().map(|&response| (response - low) as f64 / span).collect()
}
