//! `forward/filter_sizes` against its twin.

use ashsplat::kernels::constants::{PLANE_LOG_SCALE, STATE_OVERFLOW, STATE_WORDS};
use ashsplat::kernels::forward::filter_sizes::{Bind, Interface, Push, Spec};

use crate::common::gpu::{Gpu, sizes};
use crate::common::layout::{pack, place, planes, room, unpack};
use crate::common::scenes::{Random, mixed_scene};
use crate::reference::filter_sizes::filter_sizes;

const LONGEST_PX: f64 = 400.0;

fn check(overflow: u32) {
    let gpu = Gpu::new();
    let spec = Spec { workgroup_size: gpu.workgroup(64) };
    let kernel = gpu.kernel::<Interface>(&spec);
    for size in sizes(spec.workgroup_size as usize) {
        let gaussians = mixed_scene(&mut Random::new(size as u64), size, 4);
        let room = room(size);
        // No camera sees every third Gaussian.
        let depth = |i: usize| (i % 3 != 2).then_some(0.25 + (i % 17) as f64);
        let nearest: Vec<Option<f64>> = (0..size).map(depth).collect();
        let mut packed = pack(&gaussians, room);
        for (i, depth) in nearest.iter().enumerate() {
            packed[place(PLANE_LOG_SCALE, i, room)][3] = depth.unwrap_or(0.0) as f32;
        }
        let farthest = nearest.iter().flatten().copied().fold(0.0, f64::max) as f32;
        let parameters = gpu.buffer("parameters", &packed);
        let mut words = vec![0_u32; STATE_WORDS as usize];
        words[STATE_OVERFLOW as usize] = overflow;
        let bind = Bind {
            parameters: &parameters,
            state: &gpu.buffer("state", &words),
            farthest: &gpu.buffer("farthest", &[farthest.to_bits()]),
        };
        let push = Push { count: size as u32, size_per_depth: (0.2_f64.sqrt() / LONGEST_PX) as f32 };
        gpu.run(|r| r.dispatch(&kernel, &bind, &push, size as u64 / u64::from(spec.workgroup_size) + 1));
        let after = gpu.read::<[f32; 4]>(&parameters, planes(4) * room);
        assert_eq!(unpack(&after, room, size, 4), gaussians);
        if overflow != 0 {
            assert!(packed.starts_with(&after));
            continue;
        }
        for (i, expected) in filter_sizes(&nearest, LONGEST_PX).into_iter().enumerate() {
            let actual = f64::from(after[place(PLANE_LOG_SCALE, i, room)][3]);
            assert!((actual - expected).abs() <= 1e-6 * expected, "{i}: {actual} {expected}");
        }
    }
}

#[test]
fn filter_sizes_equals_its_twin() {
    check(0);
}

#[test]
fn filter_sizes_leaves_overflowed_frames_alone() {
    check(1);
}
