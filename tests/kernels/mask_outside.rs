//! `densify/mask_outside` against its twin.

use ashsplat::kernels::densify::mask_outside::{Bind, Interface, Push, Spec};

use crate::common::gpu::{Gpu, sizes};
use crate::common::layout::{pack, room};
use crate::common::scenes::{Random, mixed_scene};
use crate::reference::mask_outside::masked;

/// The box. Some sides are open.
const LOW: [f32; 3] = [-0.5, f32::MIN, -1.0];
const HIGH: [f32; 3] = [0.75, 0.25, f32::MAX];

fn check(absolute: bool) {
    let gpu = Gpu::new();
    let spec = Spec { workgroup_size: gpu.workgroup(64), absolute };
    let kernel = gpu.kernel::<Interface>(&spec);
    // The second of two chunks.
    const FIRST: usize = 5;
    let mut found = [0; 2];
    for size in sizes(spec.workgroup_size as usize) {
        let mut gaussians = mixed_scene(&mut Random::new(size as u64), size, 1);
        // Means on a side, and just outside.
        for (gaussian, x) in gaussians.iter_mut().zip([-0.5, -0.500_000_06, 0.75, 0.750_000_06]) {
            gaussian.mean = [f64::from(x as f32), 0.25, -1.0];
        }
        let parameters = gpu.buffer("parameters", &pack(&gaussians, room(size)));
        let all = size + FIRST + 1;
        let before: Vec<[f32; 2]> = (0..all).map(|i| [i as f32 * 0.5, i as f32]).collect();
        let sums: Vec<f32> = (0..all).map(|i| i as f32 * 0.25).collect();
        let statistics = gpu.buffer("statistics", &before);
        let absolutes = gpu.buffer("absolute_statistics", &sums);
        let bind = Bind { parameters: &parameters, statistics: &statistics, absolute_statistics: &absolutes };
        let push = Push { first: FIRST as u32, count: size as u32, core_low: LOW, core_high: HIGH };
        gpu.run(|r| r.dispatch(&kernel, &bind, &push, size as u64 / u64::from(spec.workgroup_size) + 1));
        let after: Vec<[f32; 2]> = gpu.read(&statistics, all);
        let sums_after: Vec<f32> = gpu.read(&absolutes, all);
        let corners = [LOW, HIGH].map(|corner| corner.map(f64::from));
        for i in 0..all {
            let mean = i.checked_sub(FIRST).and_then(|i| gaussians.get(i)).map(|gaussian| gaussian.mean);
            let expected = |sum: f32| match mean {
                Some(mean) => masked(f64::from(sum), mean.map(|x| f64::from(x as f32)), corners),
                None => f64::from(sum),
            };
            assert_eq!(f64::from(after[i][0]), expected(before[i][0]), "{i}");
            assert_eq!(after[i][1], before[i][1], "{i}");
            let expected = if absolute { expected(sums[i]) } else { f64::from(sums[i]) };
            assert_eq!(f64::from(sums_after[i]), expected, "{i}");
            found[usize::from(after[i] == before[i])] += usize::from(mean.is_some());
        }
    }
    assert!(found[0] > 20 && found[1] > 20, "{found:?}");
}

#[test]
fn mask_outside_equals_its_twin() {
    check(false);
}

#[test]
fn mask_outside_equals_its_twin_with_absolute_statistics() {
    check(true);
}
