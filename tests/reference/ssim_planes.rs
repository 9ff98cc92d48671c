//! The pictures that SSIM compares, channel by channel; the twin of `loss/ssim_planes`.

/// A channel of the rendered picture, composited on a background; 0 where the mask hides it.
pub fn rendered_plane(
    accumulated: &[[f32; 4]],
    channel: usize,
    background: [f64; 3],
    counts: impl Fn(usize) -> bool,
) -> Vec<f64> {
    let composited = |t: &[f32; 4]| f64::from(t[channel]) + f64::from(t[3]) * background[channel];
    accumulated.iter().enumerate().map(|(i, t)| if counts(i) { composited(t) } else { 0.0 }).collect()
}

/// A channel of the photograph, 0 to 255; 0 where the mask hides it.
pub fn photo_plane(photo: &[u32], channel: usize, counts: impl Fn(usize) -> bool) -> Vec<u32> {
    let byte = |word: u32| word >> (8 * channel) & 0xFF;
    photo.iter().enumerate().map(|(i, &word)| if counts(i) { byte(word) } else { 0 }).collect()
}
