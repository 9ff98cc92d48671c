//! `backward/project_adam` against `backward/project_backward` and `optimizer/adam`, which their twins judge.

use ashsplat::backward::Backward;
use ashsplat::kernels::backward::project_adam::{Bind, Interface, Push, Spec};
use ashsplat::kernels::constants::{STATE_NON_FINITE, STATE_WORDS};

use super::project_backward::{Scene, run};
use crate::common::adam::{AdamState, Rates, Step, VisibleGradient};
use crate::common::blending::assert_same;
use crate::common::gpu::{Gpu, sizes};
use crate::common::layout::{antialias_word, camera_block};
use crate::common::scenes::small_view;
use crate::reference::types::{DILATION, Drawn, Dropout, Gaussian, View};

const RATES: Rates =
    Rates { mean: 1e-3, opacity: 0.025, quat: 2e-3, log_scale: 5e-3, sh_dc: 2.5e-3, sh_rest: 1.25e-4 };
const CAMERA: [f64; 3] = [0.5, -0.25, -5.0];

/// Steps the visible Gaussians by the fused kernel. Returns how many were skipped as not finite, and the statistics.
fn fused(gpu: &Gpu, scene: &Scene, state: &AdamState, step: &Step, overflow: bool) -> (u32, Vec<[f32; 2]>) {
    let spec = Spec {
        workgroup_size: gpu.workgroup(64),
        subgroup_size: gpu.subgroup(),
        sh_degree: scene.view.sh_degree,
        filter_3d: scene.view.filter_3d > 0.0,
        own_dilation: scene.view.drawn.dilation_px2 != DILATION,
        dropout: scene.view.drawn.dropout.is_some(),
        z_record: scene.view.drawn.z_record,
        sh_loops: gpu.limits().tuning.sh_loops,
        ..Spec::default()
    };
    let kernel = gpu.kernel::<Interface>(&spec);
    let inputs = scene.upload(gpu, overflow);
    let size = scene.gaussians.len();
    let statistics = gpu.buffer("statistics", &vec![[2.0_f32, 3.0]; size]);
    let [moments_1, moments_2] = &state.moments;
    let bind = Bind {
        parameters: &state.parameters,
        state: &inputs.state,
        visible_ranges: &inputs.visible_ranges,
        visible_list: &inputs.visible_list,
        footprints: &inputs.footprints,
        first_instances: &inputs.first_instances,
        conic_opacity: &inputs.conic_opacity,
        instance_gradients_a: &inputs.instance_gradients_a,
        instance_gradients_b: &inputs.instance_gradients_b,
        instance_gradients_c: &inputs.instance_gradients_c,
        statistics: &statistics,
        new_parameters: &state.parameters,
        moments_1,
        moments_2,
        old_moments_1: moments_1,
        old_moments_2: moments_2,
        camera_block: &gpu.buffer("camera_block", &[camera_block(&scene.view)]),
    };
    let adam = state.push(step);
    let push = Push {
        first: 0,
        chunk_gaussians: state.room as u32,
        antialias: antialias_word(&scene.view),
        splat_stride: 1,
        gradient_stride: 0,
        accumulate: 1,
        push_camera_position: adam.camera_position,
        beta_1: adam.beta_1,
        beta_2: adam.beta_2,
        one_minus_beta_1: adam.one_minus_beta_1,
        one_minus_beta_2: adam.one_minus_beta_2,
        epsilon: adam.epsilon,
        rate_mean: adam.rate_mean,
        rate_opacity: adam.rate_opacity,
        rate_quat: adam.rate_quat,
        rate_log_scale: adam.rate_log_scale,
        rate_sh_dc: adam.rate_sh_dc,
        rate_sh_rest: adam.rate_sh_rest,
        inverse_bias_2: adam.inverse_bias_2,
        inverse_bias_2_opacity: adam.inverse_bias_2_opacity,
    };
    let workgroups = scene.visible.len() as u64 / u64::from(spec.workgroup_size) + 1;
    gpu.run(|r| r.dispatch(&kernel, &bind, &push, workgroups));
    let words = gpu.read::<u32>(&inputs.state, STATE_WORDS as usize);
    (words[STATE_NON_FINITE as usize], gpu.read(&statistics, size))
}

/// The gradients that the kernel of the projection alone leaves, by Gaussian, and its statistics.
fn gradients(gpu: &Gpu, scene: &Scene) -> (Vec<Option<VisibleGradient>>, Vec<[f32; 2]>) {
    let (planes, statistics) = run(gpu, scene, true, false);
    let stride = scene.visible.len() + 5;
    let wide = |place: usize| planes[place].map(f64::from);
    let mut all = vec![None; scene.gaussians.len()];
    for (row, &gaussian) in scene.visible.iter().enumerate() {
        let [x, y, z, opacity_logit] = wide(row);
        let [sx, sy, sz, _] = wide(2 * stride + row);
        let [r, g, b, _] = wide(3 * stride + row);
        all[gaussian as usize] = Some(VisibleGradient {
            mean: [x, y, z],
            opacity_logit,
            quat: wide(stride + row),
            log_scale: [sx, sy, sz],
            color: [r, g, b],
        });
    }
    (all, statistics)
}

fn scalars(set: &[Gaussian]) -> Vec<f32> {
    let of = |g: &Gaussian| {
        let all = [&g.mean[..], &g.quat, &g.log_scale, &[g.opacity_logit], g.sh.as_flattened()].concat();
        all.into_iter().map(|x| x as f32)
    };
    set.iter().flat_map(of).collect()
}

/// Two steps by the fused kernel and the rest of the optimiser, and by both kernels apart.
fn check(gpu: &Gpu, mut scene: Scene) {
    let sh_degree = scene.view.sh_degree;
    let state = || AdamState::filtered(gpu, &scene.gaussians, sh_degree, scene.view.filter_3d);
    let (apart, mut together) = (state(), state().of_unseen(sh_degree));
    for count in 1..=2 {
        let step = Step { rates: RATES, count, camera_position: CAMERA };
        let (gradients, expected) = gradients(gpu, &scene);
        let skipped = apart.step(&gradients, &step, false);
        let (fused_skipped, statistics) = fused(gpu, &scene, &together, &step, false);
        assert_eq!(together.step(&gradients, &step, false), 0, "what is seen is left alone");
        assert_eq!(fused_skipped, skipped);
        assert_eq!(statistics, expected);
        let [expected, actual] = [&apart, &together].map(AdamState::download);
        for (name, (actual, expected)) in
            ["parameters", "first moments", "second moments"].into_iter().zip(actual.iter().zip(&expected))
        {
            assert_same(gpu.context, &scalars(actual), &scalars(expected), (name, 1e-5));
        }
        // The next step is of these parameters.
        scene.gaussians = expected.into_iter().next().expect("three sets");
    }
    together = together.continued(sh_degree, false);
    let before = together.download().map(|set| scalars(&set));
    let step = Step { rates: RATES, count: 3, camera_position: CAMERA };
    let (skipped, statistics) = fused(gpu, &scene, &together, &step, true);
    assert_eq!(skipped, 0);
    assert!(statistics.iter().all(|&statistic| statistic == [2.0, 3.0]));
    let bits = |sets: [Vec<f32>; 3]| sets.concat().iter().map(|x| x.to_bits()).collect::<Vec<u32>>();
    assert!(bits(before) == bits(together.download().map(|set| scalars(&set))), "changed after an overflow");
}

/// None where a kernel has too few buffers, without push descriptors.
fn device() -> Option<Gpu> {
    let gpu = Gpu::new();
    if !Backward::can_step(gpu.context.limits()) {
        eprintln!("skipped: a kernel has {} buffers at most", gpu.context.limits().max_push_descriptors);
        return None;
    }
    Some(gpu)
}

#[test]
fn project_adam_equals_both_kernels_apart() {
    let Some(gpu) = device() else { return };
    for size in sizes(gpu.workgroup(64) as usize).into_iter().filter(|&size| size > 0) {
        check(&gpu, Scene::random(size, small_view([53, 37]), 7));
    }
}

#[test]
fn project_adam_equals_both_kernels_apart_in_every_mode() {
    let Some(gpu) = device() else { return };
    for sh_degree in 0..=3 {
        let view = View { sh_degree, antialias: sh_degree % 2 == 1, ..small_view([53, 37]) };
        check(&gpu, Scene::random(300, view, 50));
    }
}

#[test]
fn project_adam_equals_both_kernels_apart_with_filters() {
    let Some(gpu) = device() else { return };
    for (filter_3d, antialias_detached) in [(0.0, true), (0.0078125, false), (0.125, true)] {
        let drawn = Drawn { dilation_px2: f64::from(0.1_f32), ..Drawn::AS_THEY_ARE };
        let view = View { filter_3d, antialias: true, antialias_detached, drawn, ..small_view([53, 37]) };
        check(&gpu, Scene::random(300, view, 50));
    }
}

/// Gaussians with a gradient that is not finite are left alone, and counted.
#[test]
fn project_adam_skips_what_is_not_finite() {
    let Some(gpu) = device() else { return };
    let mut scene = Scene::random(200, small_view([53, 37]), 9);
    let with_instances: Vec<usize> = (0..scene.sums.len()).filter(|&i| !scene.sums[i].is_empty()).collect();
    scene.sums[with_instances[2]][0][0] = f64::NAN;
    scene.sums[with_instances[5]][0][3] = f64::INFINITY;
    scene.sums[with_instances[6]][0][7] = f64::NEG_INFINITY;
    check(&gpu, scene);
}

/// Some are left out at random, and the depth that was blended is z.
#[test]
fn project_adam_equals_both_kernels_apart_under_dropout() {
    let Some(gpu) = device() else { return };
    let dropout = Some(Dropout { below: 1 << 22, seed: 3, iteration: 9 });
    for z_record in [false, true] {
        let drawn = Drawn { dropout, z_record, ..Drawn::AS_THEY_ARE };
        check(&gpu, Scene::random(300, View { drawn, ..small_view([53, 37]) }, 50));
    }
}
