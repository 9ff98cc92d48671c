//! Lenses for the kernels of their effects.

use super::scenes::Random;
use crate::reference::lens_effects::{Rows, squares_of_radii};

/// Principal point of all pictures, as a share of their size.
const CENTER: [f32; 2] = [0.4, 0.55];

/// Random parameters near zero.
pub fn lenses(random: &mut Random, count: usize) -> Vec<[[f32; 4]; 3]> {
    (0..count).map(|_| [[0.0; 4]; 3].map(|row| row.map(|_: f32| (0.4 * random.signed()) as f32))).collect()
}

/// Returns the principal point, one over the square of half the diagonal, and the squared radii.
pub fn plane([width, height]: [u32; 2]) -> ([f32; 2], f32, Vec<f64>) {
    let center = [CENTER[0] * width as f32, CENTER[1] * height as f32];
    let inverse_square = 4.0 / (width * width + height * height) as f32;
    let r2 = squares_of_radii([width as usize, height as usize], center.map(f64::from));
    (center, inverse_square, r2)
}

pub fn wide(rows: &[[f32; 4]; 3]) -> Rows {
    rows.map(|row| row.map(f64::from))
}
