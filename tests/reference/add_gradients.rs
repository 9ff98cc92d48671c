//! Adds up the gradients of several views (Improved-GS); the twin of `optimizer/add_gradients`.

use super::types::Gaussian;

/// The sum after a view. `starts`: it is the first view. A gradient that is not finite adds nothing.
pub fn add(sum: &Gaussian, gradient: &Gaussian, starts: bool) -> Gaussian {
    let Gaussian { mean, quat, log_scale, opacity_logit, sh } = gradient;
    let mut all = mean.iter().chain(quat).chain(log_scale).chain([opacity_logit]).chain(sh.as_flattened());
    let counts = all.all(|x| x.is_finite());
    let of = |sum: f64, x: f64| if starts { 0.0 } else { sum } + if counts { x } else { 0.0 };
    Gaussian {
        mean: [0, 1, 2].map(|i| of(sum.mean[i], mean[i])),
        quat: [0, 1, 2, 3].map(|i| of(sum.quat[i], quat[i])),
        log_scale: [0, 1, 2].map(|i| of(sum.log_scale[i], log_scale[i])),
        opacity_logit: of(sum.opacity_logit, *opacity_logit),
        sh: sum.sh.iter().zip(sh).map(|(sum, x)| [0, 1, 2].map(|i| of(sum[i], x[i]))).collect(),
    }
}
