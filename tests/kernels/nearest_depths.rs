//! `forward/nearest_depths` against its twin.

use ashsplat::kernels::constants::{PLANE_LOG_SCALE, STATE_OVERFLOW, STATE_WORDS};
use ashsplat::kernels::forward::nearest_depths::{Bind, Interface, Push, Spec};

use crate::common::gpu::{Gpu, sizes};
use crate::common::layout::{pack_filtered, place, planes, room};
use crate::common::scenes::{Random, mixed_scene, small_view};
use crate::reference::nearest_depths::nearest_depth;
use crate::reference::types::{Gaussian, View};

/// Previous content.
const STALE: f64 = 5.5;

/// Cameras near and far, from three sides, with the principal point off the centre.
fn cameras() -> Vec<View> {
    let turned = |degrees: f64| {
        let (sin, cos) = degrees.to_radians().sin_cos();
        [[cos, 0.0, sin], [0.0, 1.0, 0.0], [-sin, 0.0, cos]]
    };
    let view = |degrees, translation, focal: f64, center_px| View {
        camera_from_world: turned(degrees),
        translation,
        focal_px: [focal, focal * 1.25],
        center_px,
        ..small_view([53, 37])
    };
    vec![
        view(0.0, [0.0, 0.0, 4.0], 53.0, [26.5, 18.5]),
        view(120.0, [0.5, -0.25, 1.5], 210.0, [11.0, 30.0]),
        view(250.0, [0.0, 0.0, 0.25], 20.0, [26.5, 18.5]),
    ]
}

fn pose(view: &View) -> [f32; 12] {
    let mut pose = [0.0; 12];
    let values = view.camera_from_world.concat().into_iter().chain(view.translation);
    pose.iter_mut().zip(values).for_each(|(to, x)| *to = x as f32);
    pose
}

/// Same bounds as in engine/forward/filter_3d.rs.
fn bounds(view: &View) -> [f32; 4] {
    let bound = |axis: usize, share: f64| {
        ((share * f64::from(view.size_px[axis]) - view.center_px[axis]) / view.focal_px[axis]) as f32
    };
    [bound(0, -0.15), bound(0, 1.15), bound(1, -0.15), bound(1, 1.15)]
}

/// Returns the fourth components of the log-scales, and the largest.
fn depths(gpu: &Gpu, gaussians: &[Gaussian], cameras: &[View], overflow: u32) -> (Vec<f32>, f32) {
    let spec = Spec { workgroup_size: gpu.workgroup(64), subgroup_size: gpu.subgroup() };
    let (count, room) = (gaussians.len(), room(gaussians.len()));
    let parameters = gpu.buffer("parameters", &pack_filtered(gaussians, room, STALE));
    let mut words = vec![0_u32; STATE_WORDS as usize];
    words[STATE_OVERFLOW as usize] = overflow;
    let farthest = gpu.buffer("farthest", &[0_u32]);
    let bind = Bind {
        parameters: &parameters,
        bounds: &gpu.buffer("bounds", &cameras.iter().map(bounds).collect::<Vec<_>>()),
        state: &gpu.buffer("state", &words),
        farthest: &farthest,
        poses: &gpu.buffer("poses", &cameras.iter().map(pose).collect::<Vec<_>>()),
    };
    let push = Push { count: count as u32, cameras_count: cameras.len() as u32 };
    gpu.dispatch::<Interface>(&spec, &bind, &push, count as u64 / u64::from(spec.workgroup_size) + 1);
    let packed = gpu.read::<[f32; 4]>(&parameters, planes(1) * room);
    let at = |i: usize| packed[place(PLANE_LOG_SCALE, i, room)][3];
    ((0..count).map(at).collect(), f32::from_bits(gpu.read::<u32>(&farthest, 1)[0]))
}

/// True if rounding may decide which cameras see a mean.
fn may_differ(gaussian: &Gaussian, cameras: &[View]) -> bool {
    let nudged = |by: f64| {
        let seen = |view: &View| {
            let wider = View { focal_px: view.focal_px.map(|f| f * (1.0 + by)), ..view.clone() };
            nearest_depth(gaussian.mean, std::slice::from_ref(&wider)).is_some()
        };
        cameras.iter().map(seen).collect::<Vec<bool>>()
    };
    nudged(-1e-5) != nudged(1e-5)
}

#[test]
pub fn nearest_depths_equals_its_twin() {
    let gpu = Gpu::new();
    let cameras = cameras();
    let mut seen = 0;
    for size in sizes(gpu.workgroup(64) as usize) {
        let gaussians = mixed_scene(&mut Random::new(size as u64), size, 1);
        let (actual, farthest) = depths(&gpu, &gaussians, &cameras, 0);
        for (i, gaussian) in gaussians.iter().enumerate().filter(|(_, g)| !may_differ(g, &cameras)) {
            let expected = nearest_depth(gaussian.mean, &cameras).unwrap_or(0.0);
            assert!(
                (f64::from(actual[i]) - expected).abs() <= 2e-6 * (1.0 + expected),
                "{i}: {} {expected}",
                actual[i]
            );
            seen += u32::from(expected > 0.0);
        }
        assert_eq!(farthest, actual.iter().copied().fold(0.0, f32::max));
    }
    assert!(seen > 100);
}

#[test]
pub fn nearest_depths_leaves_overflowed_frames_alone() {
    let gpu = Gpu::new();
    let gaussians = mixed_scene(&mut Random::new(3), 300, 1);
    let (actual, farthest) = depths(&gpu, &gaussians, &cameras(), 1);
    assert!(actual.iter().all(|&depth| depth == STALE as f32) && farthest == 0.0);
}
