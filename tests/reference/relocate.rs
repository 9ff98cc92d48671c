//! Opacity and scale of Gaussians at the same place (3DGS-MCMC, equation 9); the twin of `densify/relocate`.

use super::linear::sigmoid;

/// Logit and log-scales after a Gaussian was drawn `drawn` times.
pub fn relocate(logit: f64, log_scale: [f64; 3], drawn: u32) -> (f64, [f64; 3]) {
    if drawn == 0 {
        return (logit, log_scale);
    }
    let n = f64::from((drawn + 1).min(51));
    let opacity = sigmoid(logit);
    // log(1 - o), from the logit.
    let log_transparency = if logit > 0.0 { -logit - (-logit).exp().ln_1p() } else { -logit.exp().ln_1p() };
    let shared = (-(log_transparency / n).exp_m1()).clamp(0.005, 1.0 - f64::from(f32::EPSILON));
    let integrand = |u: f64| -(n * (-shared * (-u * u).exp()).ln_1p()).exp_m1();
    // The trapezoid rule converges fast for such functions: this step is accurate enough.
    const STEP: f64 = 1.0 / 32.0;
    let sum: f64 = (1..256).map(|k| integrand(STEP * f64::from(k))).sum::<f64>() + 0.5 * integrand(0.0);
    let divisor = std::f64::consts::FRAC_2_SQRT_PI * STEP * sum;
    ((shared / (1.0 - shared)).ln(), log_scale.map(|s| s + (opacity / divisor).ln()))
}
