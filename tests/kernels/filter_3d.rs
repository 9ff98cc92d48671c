//! The kernels of Mip-Splatting's 3D filter against their twins: `forward/nearest_depths` and `forward/filter_sizes`.

use crate::common::prelude::*;
use crate::reference::filter_sizes::filter_sizes as filter_sizes_twin;
use crate::reference::nearest_depths::nearest_depth;
use ashsplat::kernels::constants::{PLANE_LOG_SCALE, STATE_OVERFLOW};
use ashsplat::kernels::forward::{filter_sizes, nearest_depths};

/// Fourth components of the log-scales.
fn filters(gpu: &Gpu, parameters: &Buffer, count: usize, coefficients: usize) -> Vec<f32> {
    let capacity = plane_capacity(count);
    let packed = gpu.read::<[f32; 4]>(parameters, planes(coefficients) * capacity);
    (0..count).map(|i| packed[place(PLANE_LOG_SCALE, i, capacity)][3]).collect()
}

/// Previous content.
const STALE: f64 = 5.5;

/// Cameras near and far, from three sides, with the principal point off the centre.
fn cameras() -> Vec<View> {
    let view = |degrees, translation, focal: f64, center_px| View {
        camera_from_world: rotation_about_y(f64::to_radians(degrees)),
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

/// Same bounds as in engine/passes/filter_3d.rs.
fn bounds(view: &View) -> [f32; 4] {
    let bound = |axis: usize, share: f64| {
        ((share * f64::from(view.size_px[axis]) - view.center_px[axis]) / view.focal_px[axis]) as f32
    };
    [bound(0, -0.15), bound(0, 1.15), bound(1, -0.15), bound(1, 1.15)]
}

/// Returns the fourth components of the log-scales, and the largest.
fn depths(gpu: &Gpu, gaussians: &[Gaussian], cameras: &[View], overflow: u32) -> (Vec<f32>, f32) {
    let spec = nearest_depths::Spec { workgroup_size: gpu.workgroup(64), subgroup_size: gpu.subgroup() };
    let count = gaussians.len();
    let parameters = gpu.buffer("parameters", &pack_filtered(gaussians, plane_capacity(count), STALE));
    let farthest = gpu.buffer("farthest", &[0_u32]);
    let bind = nearest_depths::Bind {
        parameters: &parameters,
        bounds: &gpu.buffer("bounds", &cameras.iter().map(bounds).collect::<Vec<_>>()),
        state: &gpu.frame_state(&[(STATE_OVERFLOW, overflow)]),
        farthest: &farthest,
        poses: &gpu.buffer("poses", &cameras.iter().map(pose).collect::<Vec<_>>()),
    };
    let push = nearest_depths::Push { count: count as u32, cameras_count: cameras.len() as u32 };
    gpu.dispatch_over::<nearest_depths::Interface>(&spec, &bind, &push, count);
    (filters(gpu, &parameters, count, 1), gpu.read::<f32>(&farthest, 1)[0])
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
            let error = (f64::from(actual[i]) - expected).abs();
            assert!(error <= 2e-6 * (1.0 + expected), "{i}: {} {expected}", actual[i]);
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

#[test]
fn filter_sizes_equals_its_twin() {
    const LONGEST_PX: f64 = 400.0;
    let gpu = Gpu::new();
    let spec = filter_sizes::Spec { workgroup_size: gpu.workgroup(64) };
    for (size, overflow) in sizes(spec.workgroup_size as usize).into_iter().flat_map(|n| [(n, 0), (n, 1)]) {
        let gaussians = mixed_scene(&mut Random::new(size as u64), size, 4);
        // No camera sees every third Gaussian.
        let depth = |i: usize| (i % 3 != 2).then_some(0.25 + (i % 17) as f64);
        let nearest: Vec<Option<f64>> = (0..size).map(depth).collect();
        let mut packed = pack(&gaussians, plane_capacity(size));
        for (i, depth) in nearest.iter().enumerate() {
            packed[place(PLANE_LOG_SCALE, i, plane_capacity(size))][3] = depth.unwrap_or(0.0) as f32;
        }
        let farthest = nearest.iter().flatten().copied().fold(0.0, f64::max) as f32;
        let parameters = gpu.buffer("parameters", &packed);
        let bind = filter_sizes::Bind {
            parameters: &parameters,
            state: &gpu.frame_state(&[(STATE_OVERFLOW, overflow)]),
            farthest: &gpu.buffer("farthest", &[farthest.to_bits()]),
        };
        let push =
            filter_sizes::Push { count: size as u32, size_per_depth: (0.2_f64.sqrt() / LONGEST_PX) as f32 };
        gpu.dispatch_over::<filter_sizes::Interface>(&spec, &bind, &push, size);
        assert_eq!(gpu.read_gaussians(&parameters, size, 4), gaussians);
        let (expected, tolerance) = match overflow {
            0 => (filter_sizes_twin(&nearest, LONGEST_PX), 1e-6),
            // Frames that overflowed are left alone.
            _ => (nearest.iter().map(|depth| depth.unwrap_or(0.0)).collect(), 0.0),
        };
        for (i, (actual, expected)) in
            filters(&gpu, &parameters, size, 4).into_iter().zip(expected).enumerate()
        {
            let error = (f64::from(actual) - expected).abs();
            assert!(error <= tolerance * expected, "overflow {overflow}, {i}: {actual} {expected}");
        }
    }
}
