//! The derivative of the blending of one pixel (spec: "Backward"), the twin of `backward/blend_backward`.

use super::blend::samples;
use super::types::{Splat, SplatGradient};

/// Gradient of the loss with respect to a pixel.
#[derive(Clone, Copy, Debug, Default)]
pub struct PixelGradient {
    pub color: [f64; 3],
    pub inverse_depth: f64,
}

/// Adds a pixel's part to the gradients of the entries of `list`.
pub fn blend_backward(
    list: &[&Splat],
    pixel: [u32; 2],
    background: [f64; 3],
    d_pixel: PixelGradient,
    gradients: &mut [SplatGradient],
) {
    let (samples, transmittance) = samples(list, pixel);
    // Colour behind the current entry, seen through all entries in front of it.
    let mut behind_color = background.map(|x| x * transmittance);
    let mut behind_inverse_depth = 0.0;
    for sample in samples.iter().rev() {
        let splat = list[sample.entry];
        let gradient = &mut gradients[sample.entry];
        let weight = sample.weight();
        let mut d_alpha = 0.0;
        for channel in 0..3 {
            gradient.color[channel] += weight * d_pixel.color[channel];
            d_alpha += d_pixel.color[channel]
                * (sample.transmittance * splat.color[channel]
                    - behind_color[channel] / (1.0 - sample.alpha));
            behind_color[channel] += weight * splat.color[channel];
        }
        gradient.inverse_depth += weight * d_pixel.inverse_depth;
        d_alpha += d_pixel.inverse_depth
            * (sample.transmittance / splat.depth - behind_inverse_depth / (1.0 - sample.alpha));
        behind_inverse_depth += weight / splat.depth;
        if !sample.clamped {
            add_alpha(splat, pixel, sample.alpha, d_alpha, gradient);
        }
    }
}

/// α = o·exp(power), power = −½(A dx² + C dy²) − B dx dy.
pub fn add_alpha(splat: &Splat, pixel: [u32; 2], alpha: f64, d_alpha: f64, gradient: &mut SplatGradient) {
    let dx = splat.mean2d_px[0] - f64::from(pixel[0]);
    let dy = splat.mean2d_px[1] - f64::from(pixel[1]);
    let [a, b, c] = splat.conic;
    gradient.opacity += d_alpha * alpha / splat.opacity;
    let d_power = d_alpha * alpha;
    let d_mean2d = [d_power * (-a * dx - b * dy), d_power * (-c * dy - b * dx)];
    for axis in 0..2 {
        gradient.mean2d_px[axis] += d_mean2d[axis];
        gradient.absolute_px[axis] += d_mean2d[axis].abs();
    }
    gradient.conic[0] += d_power * -0.5 * dx * dx;
    gradient.conic[1] += d_power * -dx * dy;
    gradient.conic[2] += d_power * -0.5 * dy * dy;
}
