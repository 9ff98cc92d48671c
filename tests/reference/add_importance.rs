//! Importance of Gaussians over views: the twin of `densify/add_importance`.

/// The weights of a view from 0 (the smallest) to 1 (the largest); 0 if all are equal.
pub fn importance_in_view(weights: &[f64]) -> Vec<f64> {
    let low = weights.iter().copied().fold(f64::INFINITY, f64::min);
    let high = weights.iter().copied().fold(0.0, f64::max);
    weights.iter().map(|weight| if high > low { (weight - low) / (high - low) } else { 0.0 }).collect()
}

/// The mean over views.
pub fn importance(views: &[Vec<f64>]) -> Vec<f64> {
    let mut mean = vec![0.0; views.first().map_or(0, Vec::len)];
    for weights in views {
        for (mean, own) in mean.iter_mut().zip(importance_in_view(weights)) {
            *mean += own / views.len() as f64;
        }
    }
    mean
}
