//! Weights of Gaussians in a view: the twin of `densify/sum_weights`.

/// Per Gaussian the sum of its instances' weights.
pub fn sum_weights(instances: &[Vec<f64>]) -> Vec<f64> {
    instances.iter().map(|own| own.iter().sum::<f64>().max(0.0)).collect()
}
