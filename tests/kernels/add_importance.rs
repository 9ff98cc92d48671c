//! `densify/add_importance` against its twin.

use ashsplat::kernels::constants::{STATE_OVERFLOW, STATE_WORDS};
use ashsplat::kernels::densify::add_importance::{Bind, Interface, Push, Spec};

use crate::common::compare::elementwise;
use crate::common::gpu::{Gpu, sizes};
use crate::common::scenes::Random;
use crate::reference::add_importance::importance;

/// Runs the kernel over one view after another, starting from 0.
fn run(gpu: &Gpu, views: &[Vec<f32>], overflow: bool) -> Vec<f64> {
    let spec = Spec { workgroup_size: gpu.workgroup(64) };
    let kernel = gpu.kernel::<Interface>(&spec);
    let size = views[0].len();
    let mut state = vec![0; STATE_WORDS as usize];
    state[STATE_OVERFLOW as usize] = u32::from(overflow);
    let (state, importance) = (gpu.buffer("state", &state), gpu.zeros::<f32>("importance", size));
    for weights in views {
        let low = weights.iter().copied().fold(f32::INFINITY, f32::min);
        let high = weights.iter().copied().fold(0.0, f32::max);
        let ranges = gpu.buffer("ranges", &[0, 0, !low.to_bits(), high.to_bits()]);
        let weights = gpu.buffer("weights", weights);
        let bind = Bind { state: &state, weights: &weights, ranges: &ranges, importance: &importance };
        let push = Push { count: size as u32, share: 1.0 / views.len() as f32 };
        gpu.run(|r| r.dispatch(&kernel, &bind, &push, size as u64 / u64::from(spec.workgroup_size) + 1));
    }
    gpu.read::<f32>(&importance, size).into_iter().map(f64::from).collect()
}

#[test]
fn add_importance_equals_its_twin() {
    let gpu = Gpu::new();
    for size in sizes(gpu.workgroup(64) as usize).into_iter().filter(|&size| size > 0) {
        let mut random = Random::new(size as u64);
        let mut of = |low: f64| (0..size).map(|_| (low + 9.0 * random.unit()) as f32).collect::<Vec<f32>>();
        // The third view has equal weights.
        let views = [of(0.0), of(2.0), vec![4.0; size]];
        let wide = views.each_ref().map(|view| view.iter().copied().map(f64::from).collect::<Vec<f64>>());
        let actual = run(&gpu, &views, false);
        elementwise("importance", &actual, &importance(&wide), 1e-6, 1e-6).expect("importance");
        assert!(run(&gpu, &views, true).iter().all(|&value| value == 0.0));
    }
}
