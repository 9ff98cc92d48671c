//! `densify/opacity_keys` against its twin, and opacities in their order.

use ashsplat::densify::{Selection, SelectionBuffers};
use ashsplat::kernels::densify::opacity_keys::{Bind, Interface, Push, Spec};
use ashsplat::planes;
use ashsplat::vk::{Context, ContextOptions, LimitsOverride, MemoryKind};

use crate::common::engine::gaussians;
use crate::common::gpu::{Gpu, UNTOUCHED, sizes};
use crate::common::layout::{pack, room};
use crate::common::options;
use crate::common::scenes::{Random, mixed_scene};
use crate::reference::linear::sigmoid;
use crate::reference::opacity_keys::sorted;
use crate::reference::types::Gaussian;

/// Gaussians of all opacities, some of them equal, some extreme.
fn scene(count: usize) -> Vec<Gaussian> {
    let mut random = Random::new(count as u64);
    let mut scene = mixed_scene(&mut Random::new(9), count, 1);
    for gaussian in &mut scene {
        let logit = random.between(-12.0, 12.0);
        gaussian.opacity_logit = f64::from(if random.below(4) > 0 { logit } else { logit.round() } as f32);
    }
    for (gaussian, logit) in scene.iter_mut().zip([-100.0, 100.0, 0.0, -0.0]) {
        gaussian.opacity_logit = logit;
    }
    scene
}

fn logits(scene: &[Gaussian]) -> Vec<f64> {
    scene.iter().map(|gaussian| gaussian.opacity_logit).collect()
}

/// Vulkan's bound for an exponential: 3 + 2 |x| units in the last place.
#[track_caller]
fn close(actual: f32, expected: f64) {
    let error = (f64::from(actual) - expected).abs();
    assert!(error <= 4e-6 * expected + 1e-37, "{actual} for {expected}");
}

#[test]
fn opacity_keys_equal_their_twin() {
    let gpu = Gpu::new();
    let spec = Spec { workgroup_size: gpu.workgroup(64) };
    let kernel = gpu.kernel::<Interface>(&spec);
    // The second of two chunks.
    const FIRST: usize = 3;
    for size in sizes(spec.workgroup_size as usize) {
        let scene = scene(size);
        let parameters = gpu.buffer("parameters", &pack(&scene, room(size)));
        let keys = gpu.untouched::<u32>("keys", FIRST + size + 1);
        let bind = Bind { parameters: &parameters, keys: &keys };
        let push = Push { first: FIRST as u32, count: size as u32 };
        gpu.run(|r| r.dispatch(&kernel, &bind, &push, size as u64 / u64::from(spec.workgroup_size) + 1));
        let keys = gpu.read::<u32>(&keys, FIRST + size + 1);
        assert_eq!(keys[..FIRST], [UNTOUCHED; FIRST]);
        assert_eq!(keys[FIRST + size], UNTOUCHED);
        for (key, logit) in keys[FIRST..].iter().zip(logits(&scene)) {
            close(f32::from_bits(*key), sigmoid(logit));
        }
    }
}

/// With more opacities than one workgroup sorts alone, and with parameters in several buffers.
#[test]
fn opacity_keys_put_opacities_into_their_order() {
    let gpu = Gpu::new();
    let limits = LimitsOverride { max_storage_buffer_range: Some(1 << 20), ..LimitsOverride::default() };
    let options = ContextOptions { limits_override: Some(limits), ..options() };
    let in_chunks = Context::new(&options).expect("a device");
    for (context, count) in [(gpu.context, 1), (gpu.context, 77), (gpu.context, 9000), (&in_chunks, 20_000)] {
        let scene = scene(count);
        let stored = gaussians(&scene);
        let uploaded =
            planes::upload(context, "scene", &stored, count as u32, stored.sh_degree).expect("a scene");
        assert_eq!(uploaded.plan.chunks > 1, context.limits().max_storage_buffer_range == 1 << 20);
        let selection = Selection::new(context).expect("kernels");
        let requests = selection.requests(count as u32);
        let buffers = context.allocate("test", &requests, MemoryKind::Device).expect("memory");
        let buffers = SelectionBuffers::from_allocated(buffers);
        let mut recorded = None;
        let ran = context.run("order opacities", |r| {
            recorded = Some(selection.record_opacities(r, &uploaded, &buffers).clone());
            Ok(())
        });
        ran.expect("sorted");
        let bytes = context.download(&recorded.expect("recorded")).expect("read");
        let actual: Vec<f32> = bytemuck::pod_collect_to_vec(&bytes);
        assert!(actual[..count].is_sorted(), "{count}");
        for (&actual, expected) in actual.iter().zip(sorted(&logits(&scene))) {
            close(actual, expected);
        }
    }
}
