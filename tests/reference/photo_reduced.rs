//! A photograph at a fraction of its size, the twin of `pixels/photo_reduced`.

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
