//! A photograph's planes of bytes as rows of pixels, the twin of `pixels/photo_to_rows`.

use super::picture_to_rows::strip_index;

/// Returns (r, g, b, mask) per pixel.
pub fn photo_to_rows(planes: &[u8], size: [usize; 2], masked: bool) -> Vec<[u8; 4]> {
    let [width, height] = size;
    let value = |plane, pixel| planes[strip_index(plane, [pixel % width, pixel / width], size)];
    let mask = |pixel| if masked { value(3, pixel) } else { 255 };
    (0..width * height)
        .map(|pixel| [value(0, pixel), value(1, pixel), value(2, pixel), mask(pixel)])
        .collect()
}
