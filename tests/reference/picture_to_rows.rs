//! Planes in strips as rows of pixels, the twin of `pixels/picture_to_rows`.

/// Index of a pixel's value in planes in strips of eight rows: a column of a strip is contiguous, and columns are padded
/// to the next number that is 2 more than a multiple of four.
pub fn strip_index(plane: usize, [x, y]: [usize; 2], [width, height]: [usize; 2]) -> usize {
    let mut pitch = width;
    while pitch % 4 != 2 {
        pitch += 1;
    }
    let strips = height.div_ceil(8);
    ((plane * strips + y / 8) * pitch + x) * 8 + y % 8
}

/// (r, g, b, 0) per pixel, from planes in strips, or from colours without background and transmittances.
pub fn picture_to_rows(
    rendered: &[f64],
    size: [usize; 2],
    strips: bool,
    background: [f64; 3],
) -> Vec<[f64; 4]> {
    let [width, height] = size;
    let mut rows = vec![[0.0; 4]; width * height];
    for y in 0..height {
        for x in 0..width {
            for channel in 0..3 {
                let pixel = 4 * (y * width + x);
                rows[y * width + x][channel] = match strips {
                    true => rendered[strip_index(channel, [x, y], size)],
                    false => rendered[pixel + channel] + rendered[pixel + 3] * background[channel],
                };
            }
        }
    }
    rows
}
