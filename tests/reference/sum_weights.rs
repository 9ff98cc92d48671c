//! Weights of Gaussians in a view: the twin of `densify/sum_weights`.

/// Sum of the instances' weights of each Gaussian.
pub fn sum_weights(instances: &[Vec<f64>]) -> Vec<f64> {
    instances.iter().map(|own| own.iter().sum::<f64>().max(0.0)).collect()
}
