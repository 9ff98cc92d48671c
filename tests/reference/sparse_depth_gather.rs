//! Gradients at sparse points, passed on to the picture's depths and to the splats; the twin of
//! `loss/sparse_depth_gather`.

use super::blend::samples;
use super::blend_backward::add_alpha;
use super::sparse_depth::{Point, corners};
use super::types::{Splat, SplatGradient};

/// dL/d(expected depth) per pixel.
pub fn gather(points: &[Point], of_points: &[f64], size_px: [usize; 2]) -> Vec<f64> {
    let mut of_pixels = vec![0.0; size_px[0] * size_px[1]];
    for (point, gradient) in points.iter().zip(of_points) {
        for (at, share) in corners(point.position_px, size_px) {
            of_pixels[at] += share * gradient;
        }
    }
    of_pixels
}

/// Adds a pixel's part to the gradients of the entries of `list`: Z = N / A changes with each weight by (z - Z) / A.
pub fn expected_depth_backward(
    list: &[&Splat],
    pixel: [u32; 2],
    d_expected: f64,
    gradients: &mut [SplatGradient],
) {
    let (samples, _) = samples(list, pixel);
    let weight = |at: usize| samples[at].weight();
    let coverage: f64 = (0..samples.len()).map(weight).sum();
    if coverage <= 1e-10 {
        return;
    }
    let depth = |at: usize| list[samples[at].entry].depth;
    let expected = (0..samples.len()).map(|at| weight(at) * depth(at)).sum::<f64>() / coverage;
    for (at, sample) in samples.iter().enumerate() {
        let splat = list[sample.entry];
        let gradient = &mut gradients[sample.entry];
        // dL/dz, converted to dL/d(1/z).
        gradient.inverse_depth -= d_expected * weight(at) / coverage * splat.depth * splat.depth;
        let behind: f64 = (at + 1..samples.len()).map(|k| weight(k) * (depth(k) - expected)).sum();
        let of_alpha = sample.transmittance * (splat.depth - expected) - behind / (1.0 - sample.alpha);
        if !sample.clamped {
            add_alpha(splat, pixel, sample.alpha, d_expected / coverage * of_alpha, gradient);
        }
    }
}
