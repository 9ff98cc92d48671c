//! Adam over poses, and the resulting cameras (spec of training, §8): the twin of `poses/pose_step`.

use super::adam::{BETA1, BETA2, Parameter};
use super::linear::{Mat3, apply, cross, multiply, rotation};
use super::pose_gradient::left_jacobian;

pub const EPSILON: f64 = 1e-8;
/// Weight decay: the gradient gains this factor times the parameter.
pub const WEIGHT_DECAY: f64 = 1e-6;

/// One step of one parameter; `step` counts from 1.
pub fn pose_step(parameter: &mut Parameter, gradient: f64, rate: f64, step: u32) {
    let gradient = gradient + WEIGHT_DECAY * parameter.value;
    parameter.moment1 = BETA1 * parameter.moment1 + (1.0 - BETA1) * gradient;
    parameter.moment2 = BETA2 * parameter.moment2 + (1.0 - BETA2) * gradient * gradient;
    let corrected1 = parameter.moment1 / (1.0 - BETA1.powi(step as i32));
    let corrected2 = parameter.moment2 / (1.0 - BETA2.powi(step as i32));
    parameter.value -= rate * corrected1 / (corrected2.sqrt() + EPSILON);
}

/// Same as [`pose_step`] on all of ξ, but turns about the point at `depth` in front of the camera. The parameters
/// there are η, ξ = Ad η, ν = η_ν + p × η_ω. Displacements learn at the rate times the depth. Depth 0 means no
/// pivot.
pub fn step_about(depth: f64, parameters: &mut [Parameter; 6], gradient: [f64; 6], rate: f64, step: u32) {
    let pivot = [0.0, 0.0, depth];
    let xi = parameters.map(|p| p.value);
    let g: [f64; 6] = std::array::from_fn(|i| gradient[i] + WEIGHT_DECAY * xi[i]);
    let of_nu = [g[0], g[1], g[2]];
    let lever = cross(pivot, of_nu);
    let mut steps = [0.0; 6];
    for (i, parameter) in parameters.iter_mut().enumerate() {
        let (g, rate) = match i {
            0..3 => (of_nu[i], rate * if depth > 0.0 { depth } else { 1.0 }),
            _ => (g[i] - lever[i - 3], rate),
        };
        // The gradient includes the decay, so η starts at 0.
        parameter.value = 0.0;
        pose_step(parameter, g, rate, step);
        steps[i] = parameter.value;
    }
    let moved = cross(pivot, [steps[3], steps[4], steps[5]]);
    for (i, parameter) in parameters.iter_mut().enumerate() {
        parameter.value = xi[i] + steps[i] + if i < 3 { moved[i] } else { 0.0 };
    }
}

/// exp(ξ^) T₀ of ξ = (ν, ω): the rotation by its quaternion, the translation through the upper left of the left Jacobian.
pub fn moved(xi: [f64; 6], (rotation_0, translation_0): (&Mat3, [f64; 3])) -> (Mat3, [f64; 3]) {
    let omega = [xi[3], xi[4], xi[5]];
    let angle = omega.iter().map(|x| x * x).sum::<f64>().sqrt();
    let (sine, cosine) = (angle / 2.0).sin_cos();
    let axis = omega.map(|x| if angle > 0.0 { x / angle } else { 0.0 });
    let turn = rotation([cosine, sine * axis[0], sine * axis[1], sine * axis[2]]);
    let jacobian = left_jacobian(xi);
    let shift = [0, 1, 2].map(|row| (0..3).map(|column| jacobian[row][column] * xi[column]).sum::<f64>());
    let turned = apply(&turn, translation_0);
    (multiply(&turn, rotation_0), [0, 1, 2].map(|i| turned[i] + shift[i]))
}
