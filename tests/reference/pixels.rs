//! Layouts of pictures: the twins of `pixels/picture_to_rows`, `pixels/gradient_from_rows` and `pixels/photo_reduced`.

/// Index of a pixel's value in planes in strips of eight rows: a column of a strip is contiguous, and columns are padded
/// to the next number that is 2 more than a multiple of four.
pub fn strip_index(plane: usize, [x, y]: [usize; 2], [width, height]: [usize; 2]) -> usize {
    let pitch = (width..width + 4).find(|pitch| pitch % 4 == 2).unwrap_or(width);
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
    let value = |pixel: usize, channel: usize| match strips {
        true => rendered[strip_index(channel, [pixel % width, pixel / width], size)],
        false => rendered[4 * pixel + channel] + rendered[4 * pixel + 3] * background[channel],
    };
    (0..width * height).map(|i| [value(i, 0), value(i, 1), value(i, 2), 0.0]).collect()
}

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

/// Returns (r, g, b, mask) per pixel: rounded means of squares of `factor` pixels. With `masked`, a square has mask
/// 255 if all its pixels count, otherwise zeros. `change` is the change of the background of transparent
/// photographs, whose fourth byte is 1 + 254 opacity where a pixel counts.
pub fn photo_reduced(
    rows: &[[u8; 4]],
    [width, height]: [usize; 2],
    factor: usize,
    masked: bool,
    change: Option<[f32; 3]>,
) -> Vec<[u8; 4]> {
    let mean = |x: usize, y: usize| {
        let square: Vec<[u8; 4]> = (0..factor * factor)
            .map(|k| rows[(factor * y + k / factor) * width + factor * x + k % factor])
            .collect();
        let mean = |channel: usize| {
            let shown = |pixel: &[u8; 4]| {
                let through = 1.0 - (f64::from(pixel[3]) - 1.0) / 254.0;
                let change = change.map_or(0.0, |change| f64::from(change[channel]));
                f64::from(pixel[channel]) + 255.0 * change * through
            };
            let sum: f64 = square.iter().map(shown).sum();
            ((sum / square.len() as f64).clamp(0.0, 255.0) + 0.5).floor() as u8
        };
        match masked {
            true if square.iter().any(|pixel| pixel[3] == 0) => [0; 4],
            true => [mean(0), mean(1), mean(2), 255],
            false => [0, 1, 2, 3].map(mean),
        }
    };
    let places = (0..height / factor).flat_map(|y| (0..width / factor).map(move |x| (x, y)));
    places.map(|(x, y)| mean(x, y)).collect()
}
