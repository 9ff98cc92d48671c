//! Pictures and exposures for the kernels of exposure.

use ashsplat::plan::Strips;

use super::scenes::Random;
use crate::reference::expose::{IDENTITY, Matrix};
use crate::reference::picture_to_rows::{picture_to_rows, strip_index};

pub const BACKGROUND: [f32; 3] = [0.25, 0.5, 0.75];

/// Random values in a picture's native layout, and the colours that they encode.
pub fn picture(random: &mut Random, size: [usize; 2], strips: bool) -> (Vec<f32>, Vec<[f64; 3]>) {
    let native: Vec<f32> = (0..values(size)).map(|_| random.unit() as f32).collect();
    let wide: Vec<f64> = native.iter().copied().map(f64::from).collect();
    let rows = picture_to_rows(&wide, size, strips, BACKGROUND.map(f64::from));
    (native, rows.into_iter().map(|[r, g, b, _]| [r, g, b]).collect())
}

/// Floats of a native picture.
pub fn values([width, height]: [usize; 2]) -> usize {
    4 * Strips { width: width as u32, height: height as u32 }.values() as usize
}

/// Index of a pixel's channel in the native layout.
pub fn place(size: [usize; 2], strips: bool, pixel: usize, channel: usize) -> usize {
    match strips {
        true => strip_index(channel, [pixel % size[0], pixel / size[0]], size),
        false => 4 * pixel + channel,
    }
}

/// The colours of a native picture.
pub fn colors(native: &[f32], size: [usize; 2], strips: bool) -> Vec<[f64; 3]> {
    let color = |pixel| [0, 1, 2].map(|channel| f64::from(native[place(size, strips, pixel, channel)]));
    (0..size[0] * size[1]).map(color).collect()
}

/// Different matrices near the identity.
pub fn matrices(random: &mut Random, count: usize) -> Vec<[[f32; 4]; 3]> {
    let near = |identity: f64, random: &mut Random| (identity + 0.3 * random.signed()) as f32;
    (0..count).map(|_| IDENTITY.map(|row| row.map(|x| near(x, random)))).collect()
}

pub fn wide(matrix: &[[f32; 4]; 3]) -> Matrix {
    matrix.map(|row| row.map(f64::from))
}
