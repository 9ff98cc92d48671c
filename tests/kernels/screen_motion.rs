//! `forward/screen_motion` of extreme means and cameras. Tests of embedding compare its motions with the host's own.

use crate::common::prelude::*;
use ashsplat::kernels::forward::screen_motion::{Bind, Interface, Push, Spec};

/// Motions by the kernel for every second Gaussian of a range that does not begin at 0.
fn moved(gpu: &Gpu, gaussians: &[Gaussian], view: &View, before: &View) -> Vec<[f32; 2]> {
    let workgroup_size = gpu.workgroup(64);
    let capacity = plane_capacity(gaussians.len());
    // The range is that of the second culling block.
    let first = workgroup_size;
    let visible: Vec<u32> = (0..gaussians.len() as u32).step_by(2).map(|i| first + i).collect();
    let list = gpu.buffer("visible_list", &[&[UNTOUCHED; 3], visible.as_slice()].concat());
    let end = 3 + visible.len() as u32;
    let ranges = gpu.buffer("visible_ranges", &[[0; 4], [0; 4], [0; 4], [3, end, 0, 0]]);
    let motions = gpu.untouched::<[f32; 2]>("motions", end as usize + 2);
    let f = |x: f64| x as f32;
    let [previous_row_x, previous_row_y, previous_row_z] = before.camera_from_world.map(|row| row.map(f));
    let bind = Bind {
        parameters: &gpu.buffer("parameters", &pack(gaussians, capacity)),
        visible_ranges: &ranges,
        visible_list: &list,
        motions: &motions,
        camera_block: &gpu.buffer("camera_block", &[camera_block(view)]),
    };
    let push = Push {
        first,
        previous_row_x,
        previous_row_y,
        previous_row_z,
        previous_translation: before.translation.map(f),
        previous_focal_px: before.focal_px.map(f),
        previous_center_px: before.center_px.map(|x| f(x - 0.5)),
    };
    let workgroups = visible.len() as u64 / u64::from(workgroup_size) + 1;
    let [projection, previous_projection] = [view, before].map(|view| view.drawn.projection());
    let spec = Spec { workgroup_size, projection, previous_projection };
    gpu.dispatch::<Interface>(&spec, &bind, &push, workgroups);
    let words = gpu.read::<u32>(&motions, 2 * (end as usize + 2));
    assert!(words[..6].iter().chain(&words[2 * end as usize..]).all(|&word| word == UNTOUCHED));
    gpu.read::<[f32; 2]>(&motions, end as usize).split_off(3)
}

/// Means behind the previous camera, close to its plane, far aside, and NaN.
#[test]
fn screen_motion_stays_finite() {
    let gpu = Gpu::new();
    let view = small_view([53, 37]);
    let mut gaussians = mixed_scene(&mut Random::new(3), 8, 1);
    let behind = View { translation: [0.0, 0.0, -100.0], ..view.clone() };
    assert!(moved(&gpu, &gaussians, &view, &behind).iter().all(|motion| *motion == [0.0; 2]));
    // The motion is clamped to the picture's size.
    let aside = View { translation: [1e9, -1e9, 4.0], ..view.clone() };
    for motion in moved(&gpu, &gaussians, &view, &aside) {
        assert_eq!(motion, [-53.0, 37.0]);
    }
    gaussians[0].mean = [-1.0, 0.0, 0.0];
    let close = View { translation: [0.0, 0.0, 0.201], ..view.clone() };
    assert_eq!(moved(&gpu, &gaussians, &view, &close)[0][0], 53.0);
    // From infinity and to infinity: the kernel must return 0.
    for gaussian in &mut gaussians {
        gaussian.mean = [1e38, 1e38, f64::from(f32::MAX)];
    }
    let far = View { translation: [-3e38, 0.0, 3e38], ..view.clone() };
    for [from, to] in [[&far, &view], [&view, &far]] {
        let motions = moved(&gpu, &gaussians, to, from);
        assert!(motions.iter().all(|motion| *motion == [0.0; 2]), "{motions:?}");
    }
}
