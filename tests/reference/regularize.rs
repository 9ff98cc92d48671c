//! Sums of opacities and scales, and the gradient of their weighted means: the twins of `loss/regularize` and
//! `loss/term_reduce`.

use super::linear::sigmoid;
use super::types::Gaussian;

/// Sums over all Gaussians, and gradients in the fields of a Gaussian.
pub struct Sums {
    pub opacity: f64,
    pub scale: f64,
    pub gradients: Vec<Gaussian>,
}

/// `weights`: weight of the mean opacity, weight of the mean scale.
pub fn regularize(gaussians: &[Gaussian], weights: [f64; 2]) -> Sums {
    let count = gaussians.len() as f64;
    let mut sums = Sums { opacity: 0.0, scale: 0.0, gradients: Vec::new() };
    for gaussian in gaussians {
        let opacity = sigmoid(gaussian.opacity_logit);
        let scale = gaussian.log_scale.map(f64::exp);
        sums.opacity += opacity;
        sums.scale += scale.iter().sum::<f64>();
        sums.gradients.push(Gaussian {
            mean: [0.0; 3],
            quat: [0.0; 4],
            log_scale: scale.map(|scale| weights[1] / (3.0 * count) * scale),
            opacity_logit: weights[0] / count * opacity * (1.0 - opacity),
            sh: vec![[0.0; 3]; gaussian.sh.len()],
        });
    }
    sums
}

/// Returns the weighted sum, the mean opacity and the mean scale.
pub fn losses(sums: &Sums, count: usize, weights: [f64; 2]) -> [f64; 3] {
    let (opacity, scale) = (sums.opacity / count as f64, sums.scale / (3 * count) as f64);
    [weights[0] * opacity + weights[1] * scale, opacity, scale]
}
