//! The backward pass of the projection with Adam's step in it: the same bits as with the step apart.

use ashsplat::plan::LaunchSizes;
use ashsplat::trainer::{Checkpoint, OptimizerType, Preset, StrategyType, Trainer};
use ashsplat::vk::{Context, ContextOptions, LimitsOverride, SpecOverride};
use ashsplat::{TrainSettings, TrainView};

use crate::checkpoints::{settings, start, views};
use crate::common::engine::camera;
use crate::common::gpu::Gpu;
use crate::common::scenes::{rotation_about_y, small_view};
use crate::common::{assert_silent, options};
use crate::reference::types::View;

const ITERATIONS: u32 = 120;

/// A device with or without the fused kernel.
fn context(fused: bool, limits: LimitsOverride) -> Context {
    context_of(fused, ContextOptions { limits_override: Some(limits), ..options() })
}

fn context_of(fused: bool, options: ContextOptions) -> Context {
    let choice = SpecOverride { kernel: "optimizer".into(), constant: "UNSEEN".into(), bits: fused.into() };
    let options = ContextOptions { overrides: vec![choice], ..options };
    let context = Context::new(&options).expect("a device");
    assert_eq!(LaunchSizes::new(context.limits()).fused_adam, fused);
    context
}

/// Views from all sides: a part of the Gaussians is outside each.
fn around() -> Vec<TrainView> {
    let turned = |i: u32| View {
        camera_from_world: rotation_about_y(0.4 * f64::from(i)),
        focal_px: [90.0, 90.0],
        ..small_view([40, 30])
    };
    let view = |(i, view): (u32, TrainView)| TrainView::new(camera(&turned(i)), view.photo);
    (0..).zip(views(5, 9)).map(view).collect()
}

/// The end of a training, and the kernels' scopes of its last iterations.
fn trained(context: &Context, settings: &TrainSettings) -> (Checkpoint, Vec<String>) {
    let mut trainer = Trainer::new(context, around(), &start(), 5.0, settings.clone()).expect("a trainer");
    let mut scopes = Vec::new();
    for _ in 0..settings.iterations {
        let report = trainer.step().expect("a step");
        for scope in report.scopes {
            if !scopes.contains(&scope.name.to_string()) {
                scopes.push(scope.name.to_string());
            }
        }
    }
    assert_silent(context);
    (trainer.checkpoint().expect("the end"), scopes)
}

fn check(settings: &TrainSettings, limits: LimitsOverride) {
    let _gpu = Gpu::new();
    let [apart, fused] = [false, true].map(|fused| trained(&context(fused, limits), settings));
    let name = "project backward and adam".to_string();
    assert!(!apart.1.contains(&name) && fused.1.contains(&name), "{:?}", fused.1);
    assert!(apart.0 == fused.0, "other bits");
    // Some were outside a view: with dense Adam their moments decay, and they move.
    assert!(fused.0.gaussians.len() > 100);
}

fn long() -> TrainSettings {
    TrainSettings { iterations: ITERATIONS, densify_until_iter: 60, ..settings() }
}

#[test]
fn fused_adam_has_the_bits_of_the_kernels_apart() {
    check(&long(), LimitsOverride::default());
}

#[test]
fn fused_adam_has_the_same_bits_with_sparse_adam() {
    let settings = TrainSettings { optimizer_type: OptimizerType::SparseAdam, antialiasing: true, ..long() };
    check(&settings, LimitsOverride::default());
}

/// Parameters in several buffers, and the other strategy, which moves the means after each step.
#[test]
fn fused_adam_has_the_same_bits_in_chunks() {
    let settings = TrainSettings { strategy: StrategyType::Mcmc, cap_max: 400, ..long() };
    let limits = LimitsOverride { max_storage_buffer_range: Some(100_000), ..LimitsOverride::default() };
    check(&settings, limits);
}

/// Mip-Splatting's filters have variants of the kernel of their own.
#[test]
fn fused_adam_has_the_same_bits_with_filters() {
    for antialiasing_detached in [false, true] {
        let filters = TrainSettings { filter_3d: true, antialiasing: true, kernel_size: 0.1, ..long() };
        check(&TrainSettings { antialiasing_detached, ..filters }, LimitsOverride::default());
    }
}

/// What users have: growth within a budget, exposures, dropout, means of the last steps.
#[test]
fn fused_adam_has_the_same_bits_with_a_preset() {
    let preset = TrainSettings {
        iterations: ITERATIONS,
        sh_degree: 2,
        sh_degree_interval: 12,
        scale_sh_degree: false,
        densification_interval: 10,
        densify_grad_threshold: 2e-5,
        dropout: 0.2,
        exposure: true,
        lens_effects: true,
        ..TrainSettings::of_preset(Preset::Default)
    };
    check(&preset, LimitsOverride::default());
}

/// Poses need the gradients, and sets without push descriptors have fewer buffers: there the step stays apart.
#[test]
fn fused_adam_is_left_out_where_it_cannot_be() {
    let _gpu = Gpu::new();
    let poses = TrainSettings { pose_opt: true, iterations: 30, ..settings() };
    let few_buffers = || ContextOptions { push_descriptors: false, ..options() };
    let usual = TrainSettings { iterations: 30, ..settings() };
    let cases = [(options as fn() -> ContextOptions, poses), (few_buffers, usual)];
    for (options, settings) in cases {
        let [apart, fused] = [false, true].map(|fused| trained(&context_of(fused, options()), &settings));
        assert!(!fused.1.contains(&"project backward and adam".to_string()), "{:?}", fused.1);
        assert!(apart.0 == fused.0, "other bits");
    }
}
