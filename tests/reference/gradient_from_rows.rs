//! Rows of pixels as planes in strips, the twin of `pixels/gradient_from_rows`.

use super::picture_to_rows::strip_index;

/// Adds the first `planes` components of each pixel to planes in strips, or to a vec4 per pixel.
pub fn gradient_from_rows(
    rows: &[[f64; 4]],
    size: [usize; 2],
    planes: usize,
    strips: bool,
    native: &mut [f64],
) {
    let [width, _] = size;
    for (pixel, gradient) in rows.iter().enumerate() {
        for plane in 0..planes {
            let at = match strips {
                true => strip_index(plane, [pixel % width, pixel / width], size),
                false => 4 * pixel + plane,
            };
            native[at] += gradient[plane];
        }
    }
}
