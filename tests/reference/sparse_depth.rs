//! The loss of sparse points' depths (spec of training, §6); the twin of `loss/sparse_depth`.

use super::blend::samples;
use super::types::Splat;

/// A point: its position in the picture (pixel centres at the integers) and 1/z.
#[derive(Clone, Copy, Debug)]
pub struct Point {
    pub position_px: [f64; 2],
    pub inverse_z: f64,
}

/// Sum of weights z and sum of weights of a pixel.
pub fn depth_sums(list: &[&Splat], pixel: [u32; 2]) -> [f64; 2] {
    let (samples, _) = samples(list, pixel);
    samples.iter().fold([0.0; 2], |[z, one], sample| {
        [z + sample.weight() * list[sample.entry].depth, one + sample.weight()]
    })
}

pub fn expected([z, one]: [f64; 2]) -> f64 {
    z / one.max(1e-10)
}

/// The pixels that a point is sampled from, with their weights.
pub fn corners(position_px: [f64; 2], size_px: [usize; 2]) -> Vec<(usize, f64)> {
    let low = position_px.map(f64::floor);
    let mut all = Vec::new();
    for (down, right) in [(0.0, 0.0), (0.0, 1.0), (1.0, 0.0), (1.0, 1.0)] {
        let weight = |axis: usize, step: f64| 1.0 - (low[axis] + step - position_px[axis]).abs();
        let at = |axis: usize, step: f64| ((low[axis] + step) as usize).min(size_px[axis] - 1);
        all.push((at(1, down) * size_px[0] + at(0, right), weight(0, right) * weight(1, down)));
    }
    all
}

/// Returns the weighted loss, and the sampled depth of each point with its dL/d(depth).
pub fn loss(depths: &[f64], size_px: [usize; 2], points: &[Point], weight: f64) -> (f64, Vec<[f64; 2]>) {
    let mut sum = 0.0;
    let each = points.iter().map(|point| {
        let depth: f64 =
            corners(point.position_px, size_px).iter().map(|(at, share)| share * depths[*at]).sum();
        let inverse = if depth > 0.0 { 1.0 / depth } else { 0.0 };
        let difference = inverse - point.inverse_z;
        sum += difference.abs();
        let slope = if difference > 0.0 { -1.0 } else { 1.0 };
        let exists = depth > 0.0 && difference != 0.0;
        [depth, if exists { weight * slope / (points.len() as f64 * depth * depth) } else { 0.0 }]
    });
    let each = each.collect();
    (weight * sum / points.len() as f64, each)
}
