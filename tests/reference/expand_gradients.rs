//! Gradients of all the parameters of all the Gaussians, zero for the culled: the twin of
//! `backward/expand_gradients`.

use super::sh;

/// dL/dSH from dL/dcolour before its clamp: Y_k(direction)·d for the active degree, zero above.
pub fn sh_gradient(direction: [f64; 3], d_color: [f64; 3], degree: u32, stored: usize) -> Vec<[f64; 3]> {
    let basis = sh::basis(direction);
    let active = sh::coefficients(degree);
    (0..stored).map(|k| if k < active { d_color.map(|d| d * basis[k]) } else { [0.0; 3] }).collect()
}
