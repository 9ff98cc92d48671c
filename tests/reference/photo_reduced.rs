//! A photograph at a fraction of its size, the twin of `pixels/photo_reduced`.

/// (r, g, b, mask) per pixel of the means of squares of `factor` pixels, rounded. With `masked` the mask weights the
/// colours, which are 0 where its own mean is.
pub fn photo_reduced(
    rows: &[[u8; 4]],
    [width, height]: [usize; 2],
    factor: usize,
    masked: bool,
) -> Vec<[u8; 4]> {
    let rounded = |sum: f64, weight: f64| (sum / weight + 0.5).floor() as u8;
    let mean = |x: usize, y: usize| {
        let square: Vec<[f64; 4]> = (0..factor * factor)
            .map(|k| rows[(factor * y + k / factor) * width + factor * x + k % factor].map(f64::from))
            .collect();
        let sum = |channel: usize, weight: &dyn Fn(&[f64; 4]) -> f64| -> f64 {
            square.iter().map(|pixel| weight(pixel) * pixel[channel]).sum()
        };
        let mask = rounded(sum(3, &|_| 1.0), square.len() as f64);
        let color = |channel| match masked {
            true if mask == 0 => 0,
            true => rounded(sum(channel, &|pixel| pixel[3]), sum(3, &|_| 1.0)),
            false => rounded(sum(channel, &|_| 1.0), square.len() as f64),
        };
        [color(0), color(1), color(2), mask]
    };
    let places = (0..height / factor).flat_map(|y| (0..width / factor).map(move |x| (x, y)));
    places.map(|(x, y)| mean(x, y)).collect()
}
