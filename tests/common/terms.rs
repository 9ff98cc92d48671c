//! Pictures in the native layout, and the kernels of the loss's terms that several tests run.

use super::gpu::Gpu;
use super::layout::{pack, plane_capacity, unpack};
use crate::reference::pixels::strip_index;
use crate::reference::sparse_depth::Point;
use crate::reference::types::Gaussian;
use ashsplat::frame::Strips;
use ashsplat::kernels::constants::{PLANE_SH, TERM_PARTIALS};
use ashsplat::kernels::loss::{inverse_depth_l1 as inverse, regularize as sums, term_reduce as reduce};
use ashsplat::passes::loss::DepthPoint;
use ashsplat::vk::Buffer;

/// Floats of a native picture.
pub fn values([width, height]: [usize; 2]) -> usize {
    4 * Strips { width: width as u32, height: height as u32 }.values() as usize
}

/// Index of a pixel's channel in the native layout.
pub fn place(size: [usize; 2], strips: bool, pixel: usize, channel: usize) -> usize {
    match strips {
        true => strip_index(channel, [pixel % size[0], pixel / size[0]], size),
        false => 4 * pixel + channel,
    }
}

pub fn colors(native: &[f32], size: [usize; 2], strips: bool) -> Vec<[f64; 3]> {
    let color = |pixel| [0, 1, 2].map(|channel| f64::from(native[place(size, strips, pixel, channel)]));
    (0..size[0] * size[1]).map(color).collect()
}

/// Returns the weighted loss, and the sums added to the fourth plane of a gradient that was `before` everywhere.
pub fn inverse_depth_l1(
    gpu: &Gpu,
    depth: &[f32],
    targets: &[f32],
    size: [usize; 2],
    (weight, strips, before): (f64, bool, f32),
) -> (f64, Vec<f64>) {
    let spec = inverse::Spec { workgroup_size: gpu.workgroup(64), subgroup_size: gpu.subgroup(), strips };
    let kernel = gpu.kernel::<inverse::Interface>(&spec);
    let (depth, map) = (gpu.buffer("inverse_depth", depth), gpu.buffer("target_map", targets));
    let gradient = gpu.buffer("image_gradient", &vec![before; values(size)]);
    let partials = gpu.untouched::<[f32; 2]>("partials", TERM_PARTIALS as usize);
    let pixels = size[0] * size[1];
    let push = inverse::Push {
        image_width: size[0] as u32,
        image_height: size[1] as u32,
        weight: (weight / pixels as f64) as f32,
    };
    let bind = inverse::Bind {
        inverse_depth: &depth,
        target_map: &map,
        image_gradient: &gradient,
        partials: &partials,
    };
    gpu.run(|r| r.dispatch(&kernel, &bind, &push, TERM_PARTIALS.into()));
    let sums = gpu.read::<[f32; 2]>(&partials, TERM_PARTIALS as usize);
    let loss = sums.iter().map(|sums| f64::from(sums[0])).sum::<f64>() * weight / pixels as f64;
    (loss, added_to_fourth_plane(gpu, &gradient, size, (strips, before)))
}

/// Values that a kernel added to the fourth plane of a gradient that was `before` everywhere. The other planes must stay.
pub fn added_to_fourth_plane(
    gpu: &Gpu,
    gradient: &Buffer,
    size: [usize; 2],
    (strips, before): (bool, f32),
) -> Vec<f64> {
    let mut after = gpu.read::<f32>(gradient, values(size));
    let at: Vec<usize> = (0..size[0] * size[1]).map(|pixel| place(size, strips, pixel, 3)).collect();
    let added = at.iter().map(|&at| f64::from(after[at]) - f64::from(before)).collect();
    at.iter().for_each(|&at| after[at] = before);
    assert!(after.iter().all(|value| *value == before), "changed outside of the fourth plane");
    added
}

pub fn points(all: &[Point]) -> Vec<DepthPoint> {
    let f = |x: f64| x as f32;
    let point = |p: &Point| DepthPoint { position_px: p.position_px.map(f), inverse_z: f(p.inverse_z) };
    all.iter().map(point).collect()
}

/// Row of the losses, out of three, that the kernel writes.
const ROW: usize = 1;

/// Returns the weighted sum, the mean opacity, the mean scale, and the gradients as Gaussians. The Gaussians lie in
/// two chunks.
pub fn regularize(gpu: &Gpu, gaussians: &[Gaussian], weights: [f64; 2]) -> ([f64; 3], Vec<Gaussian>) {
    let spec = sums::Spec { workgroup_size: gpu.workgroup(64), subgroup_size: gpu.subgroup() };
    let kernel = gpu.kernel::<sums::Interface>(&spec);
    let partials = gpu.untouched::<[f32; 2]>("partials", TERM_PARTIALS as usize);
    let count = gaussians.len();
    let mut gradients = Vec::new();
    for (chunk, part) in [&gaussians[..count / 3], &gaussians[count / 3..]].into_iter().enumerate() {
        let capacity = plane_capacity(part.len());
        let parameters = gpu.buffer("parameters", &pack(part, capacity));
        let planes = PLANE_SH as usize * capacity;
        let d = gpu.zeros::<[f32; 4]>("parameter_gradients", planes);
        let bind = sums::Bind { parameters: &parameters, parameter_gradients: &d, partials: &partials };
        let push = sums::Push {
            count: part.len() as u32,
            continues: u32::from(chunk > 0),
            opacity_weight: (weights[0] / count as f64) as f32,
            scale_weight: (weights[1] / (3 * count) as f64) as f32,
        };
        gpu.run(|recorder| recorder.dispatch(&kernel, &bind, &push, TERM_PARTIALS.into()));
        // The result lacks the SH plane.
        let mut planes = gpu.read::<[f32; 4]>(&d, planes);
        planes.resize(planes.len() + capacity, [0.0; 4]);
        gradients.extend(unpack(&planes, capacity, part.len(), 1));
    }
    let spec = reduce::Spec { workgroup_size: gpu.workgroup(64), subgroup_size: gpu.subgroup() };
    let kernel = gpu.kernel::<reduce::Interface>(&spec);
    let losses = gpu.untouched::<[f32; 4]>("losses", 3);
    let push = reduce::Push {
        row: ROW as u32,
        values: [count as f32, 3.0 * count as f32],
        weights: weights.map(|weight| weight as f32),
    };
    let bind = reduce::Bind { partials: &partials, losses: &losses };
    gpu.run(|recorder| recorder.dispatch(&kernel, &bind, &push, 1));
    let [value, opacity, scale, _] = gpu.read::<[f32; 4]>(&losses, 3)[ROW].map(f64::from);
    ([value, opacity, scale], gradients)
}
