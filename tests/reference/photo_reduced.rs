//! A photograph at a fraction of its size, the twin of `pixels/photo_reduced`.

/// (r, g, b, mask) per pixel of the means of squares of `factor` pixels, rounded. With `masked` a square counts, with mask 255,
/// if all of its pixels do, and has zeros otherwise.
pub fn photo_reduced(
    rows: &[[u8; 4]],
    [width, height]: [usize; 2],
    factor: usize,
    masked: bool,
) -> Vec<[u8; 4]> {
    let mean = |x: usize, y: usize| {
        let square: Vec<[u8; 4]> = (0..factor * factor)
            .map(|k| rows[(factor * y + k / factor) * width + factor * x + k % factor])
            .collect();
        let mean = |channel: usize| {
            let sum: f64 = square.iter().map(|pixel| f64::from(pixel[channel])).sum();
            (sum / square.len() as f64 + 0.5).floor() as u8
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
