//! Merges Mip-Splatting's 3D filter (Yu et al. 2024, section 5.1) into the parameters.

use super::gaussians::Gaussians;
use crate::error::{Error, Result};

/// Log-scales and opacity logit of a Gaussian after convolution with one of standard deviation `size`, world units, that
/// preserves its integral along each axis. Unchanged if the size is not positive.
pub fn filtered(log_scale: [f32; 3], opacity_logit: f32, size: f32) -> ([f32; 3], f32) {
    if size.is_nan() {
        return ([f32::NAN; 3], opacity_logit);
    }
    if size <= 0.0 {
        return (log_scale, opacity_logit);
    }
    let log_size = f64::from(size).ln();
    // ln(s_f / s) = ln(1 + (size / s)^2) / 2
    let growth = log_scale.map(|log_scale| 0.5 * (2.0 * (log_size - f64::from(log_scale))).exp().ln_1p());
    let widened = [0, 1, 2].map(|axis| (f64::from(log_scale[axis]) + growth[axis]) as f32);
    // logit(o c) with ln c = -sum is -ln((1 + exp(-x)) / c - 1). Terms that may be large are taken out of the logarithm.
    let (sum, x) = (growth.iter().sum::<f64>(), f64::from(opacity_logit));
    let rest = -(-sum).exp_m1();
    let logit = match x < 0.0 {
        true => x - sum - (rest * x.exp()).ln_1p(),
        false => -sum - (rest + (-x).exp()).ln(),
    };
    (widened, logit as f32)
}

impl Gaussians {
    /// Merges the 3D filter into scales and opacities, so that any renderer draws it. `filters` has one size per Gaussian,
    /// world units: [`Trainer::filters`](crate::Trainer::filters).
    ///
    /// # Errors
    /// [`Error::Argument`] if the number of sizes differs from the number of Gaussians.
    pub fn bake_filters(&mut self, filters: &[f32]) -> Result<()> {
        if filters.len() != self.len() {
            let problem = format!("are {}, there are {} Gaussians", filters.len(), self.len());
            return Err(Error::argument("filters", problem));
        }
        for (index, &size) in filters.iter().enumerate() {
            let (log_scale, logit) = filtered(self.log_scales[index], self.opacity_logits[index], size);
            (self.log_scales[index], self.opacity_logits[index]) = (log_scale, logit);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn filtered_gaussians_are_those_of_the_formula() {
        for size in [1e-3_f32, 0.1, 7.0] {
            for log_scale in [[-9.0_f32, -2.0, 1.0], [0.0; 3]] {
                for logit in [-30.0_f32, -4.0, 0.0, 5.0, 30.0] {
                    let (scales, opacity) = filtered(log_scale, logit, size);
                    let size = f64::from(size);
                    let scale = log_scale.map(|s| f64::from(s).exp());
                    let wide = scale.map(|s| s.hypot(size));
                    let shrink: f64 = (0..3).map(|i| scale[i] / wide[i]).product();
                    let expected = shrink / (1.0 + (-f64::from(logit)).exp());
                    let actual = 1.0 / (1.0 + (-f64::from(opacity)).exp());
                    assert!((actual / expected - 1.0).abs() < 1e-5, "{actual} {expected}");
                    for (scale, wide) in scales.iter().zip(wide) {
                        assert!((f64::from(*scale) - wide.ln()).abs() < 1e-5);
                    }
                }
            }
        }
        assert_eq!(filtered([-1.0, 2.0, 0.0], 3.0, 0.0), ([-1.0, 2.0, 0.0], 3.0));
        assert!(filtered([0.0; 3], 0.0, f32::NAN).0[0].is_nan());
    }

    #[test]
    fn each_gaussian_has_one_size() {
        let mut none = Gaussians::default();
        assert!(none.bake_filters(&[1.0]).is_err() && none.bake_filters(&[]).is_ok());
    }
}
