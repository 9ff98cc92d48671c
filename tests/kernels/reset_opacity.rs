//! `densify/reset_opacity` against its twin.

use ashsplat::kernels::constants::PLANE_LOG_SCALE;
use ashsplat::kernels::densify::reset_opacity::{Bind, Interface, Push, Spec};

use crate::common::gpu::{Gpu, sizes};
use crate::common::layout::{pack, place, planes, room, unpack};
use crate::common::scenes::{Random, mixed_scene};
use crate::reference::filter_sizes::shrink;
use crate::reference::reset_opacity::reset_opacity;
use crate::reference::types::Gaussian;

/// Every third of four has no filter.
fn filter_of(index: usize) -> f64 {
    [0.25, 4.0, 0.0, 0.015625][index % 4]
}

fn check(filters: bool) {
    let gpu = Gpu::new();
    let spec = Spec { workgroup_size: gpu.workgroup(64) };
    let kernel = gpu.kernel::<Interface>(&spec);
    for size in sizes(spec.workgroup_size as usize) {
        let mut gaussians = mixed_scene(&mut Random::new(size as u64), size, 4);
        if size > 2 {
            gaussians[1].opacity_logit = f64::INFINITY;
            gaussians[2].opacity_logit = f64::NEG_INFINITY;
        }
        let shrink_of = |i: usize| if filters { shrink(&gaussians[i], filter_of(i)) } else { 1.0 };
        let room = room(size);
        let mut packed = pack(&gaussians, room);
        if filters {
            (0..size).for_each(|i| packed[place(PLANE_LOG_SCALE, i, room)][3] = filter_of(i) as f32);
        }
        let [parameters, moments_1, moments_2] =
            ["parameters", "moments_1", "moments_2"].map(|name| gpu.buffer(name, &packed));
        let bind = Bind { parameters: &parameters, moments_1: &moments_1, moments_2: &moments_2 };
        let max_logit = (0.01_f64 / 0.99).ln() as f32;
        let push = Push { count: size as u32, max_opacity: 0.01, max_logit };
        gpu.run(|recorder| {
            recorder.dispatch(&kernel, &bind, &push, size as u64 / u64::from(spec.workgroup_size) + 1)
        });
        let [after, moments_1, moments_2] = [parameters, moments_1, moments_2]
            .map(|buffer| unpack(&gpu.read::<[f32; 4]>(&buffer, planes(4) * room), room, size, 4));
        for (i, before) in gaussians.iter().enumerate() {
            let expected = reset_opacity(before.opacity_logit, shrink_of(i));
            let actual = after[i].opacity_logit;
            let close = actual == expected || (actual - expected).abs() < 1e-5;
            assert!(close, "{i}: {actual}, expected {expected}");
            let rest = |g: &Gaussian| Gaussian { opacity_logit: 0.0, ..g.clone() };
            assert_eq!(rest(&after[i]), rest(before), "{i}");
            assert_eq!(moments_1[i], rest(before), "{i}");
            assert_eq!(moments_2[i], rest(before), "{i}");
        }
    }
}

#[test]
fn reset_opacity_equals_its_twin() {
    check(false);
}

#[test]
fn reset_opacity_equals_its_twin_with_3d_filters() {
    check(true);
}
