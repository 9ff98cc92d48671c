//! `forward/splat_surfaces` against its twin.

use super::compose::from_half;
use crate::common::prelude::*;
use crate::reference::splat_surface::{depth_slope, splat_normal};
use ashsplat::kernels::forward::splat_surfaces::{Bind, Interface, Push, Spec};

/// The kernel's normals and slopes of every second Gaussian of a range that begins behind others.
fn surfaces(gpu: &Gpu, gaussians: &[Gaussian], view: &View) -> Vec<[f32; 4]> {
    let workgroup_size = gpu.workgroup(64);
    // The range is that of the second culling block.
    let first = workgroup_size;
    let visible: Vec<u32> = (0..gaussians.len() as u32).step_by(2).map(|i| first + i).collect();
    let end = 3 + visible.len() as u32;
    let surfaces = gpu.untouched::<[f32; 4]>("splat_surfaces", end as usize + 2);
    let bind = Bind {
        parameters: &gpu.buffer("parameters", &pack(gaussians, room(gaussians.len()))),
        visible_ranges: &gpu.buffer("visible_ranges", &[[0; 4], [0; 4], [0; 4], [3, end, 0, 0]]),
        visible_list: &gpu.buffer("visible_list", &[&[UNTOUCHED; 3], visible.as_slice()].concat()),
        splat_surfaces: &surfaces,
        camera_block: &gpu.buffer("camera_block", &[camera_block(view)]),
    };
    let workgroups = visible.len() as u64 / u64::from(workgroup_size) + 1;
    let spec = Spec { workgroup_size, projection: view.drawn.projection() };
    gpu.dispatch::<Interface>(&spec, &bind, &Push { first }, workgroups);
    let words = gpu.read::<[u32; 4]>(&surfaces, end as usize + 2);
    assert!(words[..3].iter().chain(&words[end as usize..]).all(|&word| word == [UNTOUCHED; 4]));
    gpu.read::<[f32; 4]>(&surfaces, end as usize).split_off(3)
}

#[test]
fn splat_surfaces_equal_their_twin() {
    let gpu = Gpu::new();
    for (size, orthographic) in [1, 33, 500].into_iter().flat_map(|size| [(size, false), (size, true)]) {
        let view = View { drawn: Drawn { orthographic, ..Drawn::AS_THEY_ARE }, ..small_view([53, 37]) };
        let mut gaussians = mixed_scene(&mut Random::new(size as u64), size, 1);
        // A disk of 2DGS, and a quaternion of zeros.
        gaussians[0].log_scale = [-1.0, -1.5, f64::from(f32::MIN)];
        gaussians[size / 4 * 2].quat = [0.0; 4];
        let mut slopes = 0;
        for (gaussian, actual) in gaussians.iter().step_by(2).zip(surfaces(&gpu, &gaussians, &view)) {
            let (expected, facing) = splat_normal(gaussian, &view);
            let close = |sign: f64| (0..3).all(|i| (f64::from(actual[i]) - sign * expected[i]).abs() < 1e-5);
            // From the edge on, rounding chooses the side.
            let either = facing > -1e-5 && close(-1.0);
            assert!(close(1.0) || either, "{actual:?}, expected {expected:?}");
            let Some(expected) = depth_slope(gaussian, &view) else { continue };
            for axis in 0..2 {
                let (actual, expected) =
                    (from_half((actual[3].to_bits() >> (16 * axis)) as u16), expected[axis]);
                assert!(
                    (actual - expected).abs() < 1e-4 + 1e-3 * expected.abs(),
                    "{actual}, expected {expected}"
                );
            }
            slopes += 1;
        }
        assert!(slopes > size / 4);
    }
}
