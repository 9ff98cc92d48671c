//! `densify/draw_weights` against its twin.

use ashsplat::kernels::densify::draw_weights::{Bind, Interface, Push, Spec};

use crate::common::gpu::{Gpu, UNTOUCHED, sizes};
use crate::common::layout::{pack, room};
use crate::common::scenes::{Random, mixed_scene};
use crate::reference::draw_weights::{unit, weight};

#[test]
fn draw_weights_equals_its_twin() {
    let gpu = Gpu::new();
    let spec = Spec { workgroup_size: gpu.workgroup(64) };
    let kernel = gpu.kernel::<Interface>(&spec);
    // The second of two chunks.
    const FIRST: usize = 5;
    for size in sizes(spec.workgroup_size as usize) {
        let mut gaussians = mixed_scene(&mut Random::new(size as u64), size, 1);
        for (gaussian, logit) in gaussians.iter_mut().zip([-80.0, -5.3, -5.29, 80.0]) {
            gaussian.opacity_logit = logit;
        }
        for least in [0.005, -1.0] {
            let unit = unit(size + FIRST);
            let parameters = gpu.buffer("parameters", &pack(&gaussians, room(size)));
            let [weights, draws] =
                ["weights", "draws"].map(|name| gpu.untouched::<u32>(name, size + FIRST + 1));
            let bind = Bind { parameters: &parameters, weights: &weights, draws: &draws };
            let push = Push {
                first: FIRST as u32,
                count: size as u32,
                unit: unit as f32,
                least_opacity: least as f32,
            };
            gpu.run(|r| r.dispatch(&kernel, &bind, &push, size as u64 / u64::from(spec.workgroup_size) + 1));
            let [weights, draws] = [&weights, &draws].map(|buffer| gpu.read::<u32>(buffer, size + FIRST + 1));
            for (i, gaussian) in gaussians.iter().enumerate() {
                let expected = weight(gaussian.opacity_logit, unit, least);
                let actual = f64::from(weights[FIRST + i]);
                assert!(
                    (actual - expected).abs() <= 1.0 + 1e-6 * expected,
                    "{i}: {actual}, expected {expected}"
                );
                assert_eq!(actual > 0.0, expected > 0.0, "{i}");
                assert_eq!(draws[FIRST + i], 0);
            }
            for buffer in [weights, draws] {
                let others = buffer[..FIRST].iter().chain(&buffer[FIRST + size..]);
                assert!(others.copied().all(|word| word == UNTOUCHED));
            }
        }
    }
}
