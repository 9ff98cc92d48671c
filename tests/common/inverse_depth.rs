//! The inverse-depth term's kernel.

use ashsplat::kernels::constants::TERM_PARTIALS;
use ashsplat::kernels::loss::inverse_depth_l1::{Bind, Interface, Push, Spec};

use super::exposures::{place, values};
use super::gpu::Gpu;

/// Returns the weighted loss, and the sums added to the fourth plane of a gradient that was `before` everywhere.
pub fn inverse_depth_l1(
    gpu: &Gpu,
    depth: &[f32],
    targets: &[f32],
    size: [usize; 2],
    (weight, strips, before): (f64, bool, f32),
) -> (f64, Vec<f64>) {
    let spec = Spec { workgroup_size: gpu.workgroup(64), subgroup_size: gpu.subgroup(), strips };
    let kernel = gpu.kernel::<Interface>(&spec);
    let (depth, map) = (gpu.buffer("inverse_depth", depth), gpu.buffer("target_map", targets));
    let gradient = gpu.buffer("image_gradient", &vec![before; values(size)]);
    let partials = gpu.untouched::<[f32; 2]>("partials", TERM_PARTIALS as usize);
    let pixels = size[0] * size[1];
    let push = Push {
        image_width: size[0] as u32,
        image_height: size[1] as u32,
        weight: (weight / pixels as f64) as f32,
    };
    let bind =
        Bind { inverse_depth: &depth, target_map: &map, image_gradient: &gradient, partials: &partials };
    gpu.run(|r| r.dispatch(&kernel, &bind, &push, TERM_PARTIALS.into()));
    let sums = gpu.read::<[f32; 2]>(&partials, TERM_PARTIALS as usize);
    let loss = sums.iter().map(|sums| f64::from(sums[0])).sum::<f64>() * weight / pixels as f64;
    let mut after = gpu.read::<f32>(&gradient, values(size));
    let at: Vec<usize> = (0..pixels).map(|pixel| place(size, strips, pixel, 3)).collect();
    let added = at.iter().map(|&at| f64::from(after[at]) - f64::from(before)).collect();
    at.iter().for_each(|&at| after[at] = before);
    assert!(after.iter().all(|value| *value == before), "changed outside of the fourth plane");
    (loss, added)
}
