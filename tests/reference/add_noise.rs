//! Noise on the means (3DGS-MCMC, section 4); the twin of `optimizer/add_noise`.

use super::linear::{apply, normalize_quat, rotation, sigmoid, transpose};
use super::types::Gaussian;

/// Displacement of a mean, world units: the covariance times standard normal numbers, gated by the opacity.
pub fn noise(gaussian: &Gaussian, normal: [f64; 3], rate: f64) -> [f64; 3] {
    let gate = sigmoid(-100.0 * (sigmoid(gaussian.opacity_logit) - 0.005));
    let rotation = rotation(normalize_quat(gaussian.quat).0);
    let variance = gaussian.log_scale.map(|s| (2.0 * s).exp());
    let own = apply(&transpose(&rotation), normal);
    apply(&rotation, [0, 1, 2].map(|axis| variance[axis] * own[axis])).map(|x| rate * gate * x)
}
