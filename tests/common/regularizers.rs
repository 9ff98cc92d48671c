//! The opacity and scale regularisers' kernels.

use ashsplat::kernels::constants::{PLANE_SH, TERM_PARTIALS};
use ashsplat::kernels::loss::{regularize as sums, term_reduce as reduce};

use super::gpu::Gpu;
use super::layout::{pack, room, unpack};
use crate::reference::types::Gaussian;

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
        let room = room(part.len());
        let parameters = gpu.buffer("parameters", &pack(part, room));
        let planes = PLANE_SH as usize * room;
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
        planes.resize(planes.len() + room, [0.0; 4]);
        gradients.extend(unpack(&planes, room, part.len(), 1));
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
