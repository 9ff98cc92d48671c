//! Adam (spec: "Loss, optimiser, schedule"): the twin of `optimizer/adam`.

pub const BETA1: f64 = 0.9;
pub const BETA2: f64 = 0.999;
pub const EPSILON: f64 = 1e-15;

#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Parameter {
    pub value: f64,
    pub moment1: f64,
    pub moment2: f64,
}

/// A step with bias correction; `step` counts from 1.
pub fn adam(parameter: &mut Parameter, gradient: f64, rate: f64, step: u32) {
    accumulate(parameter, gradient);
    let corrected1 = parameter.moment1 / (1.0 - BETA1.powi(step as i32));
    let corrected2 = parameter.moment2 / (1.0 - BETA2.powi(step as i32));
    parameter.value -= rate * corrected1 / (corrected2.sqrt() + EPSILON);
}

/// The sparse variant, for visible Gaussians only: no bias correction.
pub fn adam_sparse(parameter: &mut Parameter, gradient: f64, rate: f64) {
    accumulate(parameter, gradient);
    parameter.value -= rate * parameter.moment1 / (parameter.moment2.sqrt() + EPSILON);
}

/// True if the kernel skips (and counts) a Gaussian with these gradients.
pub fn is_skipped(gradients: &[f64]) -> bool {
    gradients.iter().any(|gradient| !gradient.is_finite())
}

fn accumulate(parameter: &mut Parameter, gradient: f64) {
    parameter.moment1 = BETA1 * parameter.moment1 + (1.0 - BETA1) * gradient;
    parameter.moment2 = BETA2 * parameter.moment2 + (1.0 - BETA2) * gradient * gradient;
}
