//! Front-to-back blending of one pixel (spec: "Forward" 8), the twin of `forward/blend`.

use super::tiles::alpha_unclamped;
use super::types::{ALPHA_MAX, ALPHA_MIN, NEAR, Splat, TRANSMITTANCE_MIN};

#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Pixel {
    /// Colour over the background.
    pub color: [f64; 3],
    pub transmittance: f64,
    /// Σ α T / z.
    pub inverse_depth: f64,
    /// 1-based place in the list of the last entry blended, 0 when none.
    pub last: u32,
    pub blended: u32,
}

/// One entry that was blended at a pixel.
#[derive(Clone, Copy, Debug)]
pub struct Sample {
    pub entry: usize,
    /// α after the clamp.
    pub alpha: f64,
    /// True if the clamp at 0.99 acted.
    pub clamped: bool,
    /// Transmittance in front of it.
    pub transmittance: f64,
}

impl Sample {
    /// Share of the pixel's colour.
    pub fn weight(&self) -> f64 {
        self.alpha * self.transmittance
    }
}

/// The entries of `list` (front to back) that are blended at a pixel, and the transmittance behind them.
pub fn samples(list: &[&Splat], pixel: [u32; 2]) -> (Vec<Sample>, f64) {
    let mut transmittance = 1.0;
    let mut samples = Vec::new();
    for (entry, splat) in list.iter().enumerate() {
        let Some(unclamped) = alpha_unclamped(splat, pixel) else { continue };
        let alpha = unclamped.min(ALPHA_MAX);
        if alpha < ALPHA_MIN {
            continue;
        }
        if transmittance * (1.0 - alpha) < TRANSMITTANCE_MIN {
            break;
        }
        samples.push(Sample { entry, alpha, clamped: unclamped > ALPHA_MAX, transmittance });
        transmittance *= 1.0 - alpha;
    }
    (samples, transmittance)
}

pub fn blend(list: &[&Splat], pixel: [u32; 2], background: [f64; 3]) -> Pixel {
    let (samples, transmittance) = samples(list, pixel);
    let mut result = Pixel { transmittance, ..Pixel::default() };
    for sample in &samples {
        let (splat, weight) = (list[sample.entry], sample.weight());
        for channel in 0..3 {
            result.color[channel] += weight * splat.color[channel];
        }
        result.inverse_depth += weight / splat.depth;
        result.last = sample.entry as u32 + 1;
        result.blended += 1;
    }
    for channel in 0..3 {
        result.color[channel] += transmittance * background[channel];
    }
    result
}

/// Auxiliary values of a pixel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AuxiliaryValues {
    /// The largest weight; 0 for none.
    pub heaviest: f64,
    /// Σ α T m, px.
    pub motion: [f64; 2],
    /// Σ α T n.
    pub normal: [f64; 3],
}

/// Returns the auxiliary values of a pixel for the motions and normals of a list, and the weight of each place in it.
pub fn beside(
    list: &[&Splat],
    (motions, normals): (&[[f64; 2]], &[[f64; 3]]),
    pixel: [u32; 2],
) -> (AuxiliaryValues, Vec<f64>) {
    let (mut result, mut weights) = (AuxiliaryValues::default(), vec![0.0; list.len()]);
    for sample in &samples(list, pixel).0 {
        let weight = sample.weight();
        weights[sample.entry] = weight;
        result.heaviest = result.heaviest.max(weight);
        for axis in 0..2 {
            result.motion[axis] += weight * motions[sample.entry][axis];
        }
        for axis in 0..3 {
            result.normal[axis] += weight * normals[sample.entry][axis];
        }
    }
    (result, weights)
}

/// True if `depth` is that of the splat behind which the transmittance is below `limit` (0 if there is none), with a
/// tolerance of the transmittance. `slopes`: change of depth per px of each splat of the list.
pub fn is_surface_depth(
    depth: f64,
    limit: f64,
    (list, slopes): (&[&Splat], &[[f64; 2]]),
    pixel: [u32; 2],
    tolerance: f64,
) -> bool {
    let (samples, behind) = samples(list, pixel);
    if depth == 0.0 {
        return behind > limit - tolerance;
    }
    samples.iter().any(|sample| {
        let falls = sample.transmittance > limit - tolerance
            && sample.transmittance * (1.0 - sample.alpha) < limit + tolerance;
        let (splat, [x, y]) = (list[sample.entry], slopes[sample.entry]);
        let [dx, dy] = [0, 1].map(|axis| f64::from(pixel[axis]) - splat.mean2d_px[axis]);
        falls && (depth - (splat.depth + x * dx + y * dy).max(NEAR)).abs() < 1e-4 * splat.depth.max(depth)
    })
}

/// The splats of a list that do not lie behind a limit, 1/z.
pub fn before<'a>(list: &[&'a Splat], least_inverse_z: f64) -> Vec<&'a Splat> {
    list.iter().copied().filter(|splat| 1.0 / splat.depth >= least_inverse_z).collect()
}
