//! Rows of the tuning table on the present device: a GPU's kernels on a software driver, and vice versa.

use crate::common::blending::assert_alike;
use crate::common::prelude::*;
use ashsplat::frame::tuning::{Backend, Tuning};
use ashsplat::frame::{LaunchSizes, SortMethod};
use ashsplat::kernels::sort::sort_downsweep;
use ashsplat::vk::{KernelInterface, Requirements};

fn context(backend: Backend) -> Context {
    Context::new(&ContextOptions { backend: Some(backend), ..options() }).expect("a device")
}

/// Largest difference, relative to values above 1.
fn difference(a: &[f32], b: &[f32]) -> f32 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(a, b)| (a - b).abs() / b.abs().max(1.0)).fold(0.0, f32::max)
}

fn picture(context: &Context) -> Vec<f32> {
    let scene = gaussians(&mixed_scene(&mut Random::new(5), 900, 16));
    let camera = camera(&small_view([203, 117]));
    let frame = loaded(context, &scene).render(&camera, &RenderSettings::default()).expect("a picture");
    assert_silent(context);
    frame.color.into_flattened()
}

#[test]
fn backends_draw_the_same_picture_with_other_kernels() {
    let _gpu = Gpu::new();
    let contexts = [Backend::Processor, Backend::Gpu].map(context);
    let sizes = contexts.each_ref().map(|context| LaunchSizes::new(context.limits()));
    assert_ne!(sizes[0].sort_method, sizes[1].sort_method);
    assert_ne!(sizes[0].tuning.incremental_exp, sizes[1].tuning.incremental_exp);
    let pictures = contexts.each_ref().map(picture);
    assert!(pictures[0].iter().any(|&value| value > 0.1), "the picture is black");
    assert!(difference(&pictures[0], &pictures[1]) < 2e-4);
}

#[test]
fn backends_train_alike() {
    let _gpu = Gpu::new();
    let settings = TrainSettings {
        sh_degree_interval: 2,
        densify_from_iter: 3,
        densification_interval: 4,
        ..TrainSettings::reference()
    };
    let trained = [Backend::Processor, Backend::Gpu].map(|backend| {
        let context = context(backend);
        let reports = Run::new(&context, views(2, 5), settings.clone()).begin().steps(6);
        assert_silent(&context);
        reports.iter().map(|report| report.loss).collect::<Vec<f32>>()
    });
    assert!(difference(&trained[0], &trained[1]) < 1e-4, "{trained:?}");
}

/// Loops over SH coefficients that are not unrolled add in the same order: pictures, trainings with and without
/// poses.
#[test]
fn backends_of_both_kinds_of_loops_and_with_shared_splats_have_the_same_bits() {
    ["SH_LOOPS", "SHARED_SPLATS"].into_iter().for_each(compare_switched);
}

fn compare_switched(constant: &str) {
    let _gpu = Gpu::new();
    let switched = |on: bool| {
        let overridden =
            SpecOverride { kernel: String::new(), constant: constant.to_owned(), bits: on.into() };
        Context::new(&ContextOptions { overrides: vec![overridden], ..options() }).expect("a device")
    };
    let contexts = [false, true].map(switched);
    let scene = gaussians(&mixed_scene(&mut Random::new(6), 300, 16));
    for (strategy, pose_opt) in
        [(StrategyType::Reference, false), (StrategyType::Reference, true), (StrategyType::Budget, false)]
    {
        let settings = TrainSettings {
            iterations: 20,
            sh_degree_interval: 2,
            scale_sh_degree: false,
            strategy,
            pose_opt,
            ..TrainSettings::of_strategy(strategy)
        };
        let [off, on] = contexts.each_ref().map(|context| {
            let camera = camera(&small_view([67, 43]));
            let frame = loaded(context, &scene).render(&camera, &RenderSettings::default());
            let run = Run::new(context, views(2, 5), settings.clone());
            let end = run.starting_at(&scene).end(&[]);
            assert_silent(context);
            (context, frame.expect("a picture").color, end.fingerprint())
        });
        assert!(off.1.iter().flatten().any(|&x| x > 0.1), "the picture is black");
        let what = format!("the pictures of {constant}, {strategy:?},");
        assert_alike(on.0, off.1.as_flattened(), on.1.as_flattened(), (&what, 1e-5));
        // Another compiler may fuse different sums of products, and trainings diverge with the first different bit.
        if on.0.description().kind == "CPU" {
            assert!(off.2 == on.2, "{constant}, {strategy:?}: other bits");
        }
    }
}

/// Workgroups of tiles fit into the required minimum of devices with such subgroups; subgroups of more than 32 need
/// more.
#[test]
fn backends_fit_into_the_workgroups_that_are_asked_of_devices() {
    for tuning in [&Tuning::PROCESSOR, &Tuning::GPU, &Tuning::INTEL, &Tuning::AMD, &Tuning::NVIDIA] {
        for lanes in [4, 8, 16, 32, 64, 128] {
            let mut limits = Gpu::new().context.limits().clone();
            let min = Requirements::workgroup_invocations(lanes);
            limits.tuning = tuning;
            limits.max_workgroup_invocations = min;
            limits.shared_memory_bytes = Requirements::MIN_SHARED_MEMORY;
            [limits.subgroup_size, limits.heavy_subgroup_size] = [lanes; 2];
            let sizes = LaunchSizes::new(&limits);
            let tiles = [sizes.blend, sizes.blend_heavy].map(|shape| shape.tile);
            assert!(tiles.iter().all(|tile| *tile <= min), "{:?}, {lanes}: {tiles:?}", tuning.backend);
            let sort = sort_downsweep::Spec {
                workgroup_size: sizes.sort_workgroup,
                subgroup_size: lanes,
                items: sizes.sort_items,
                identity_values: false,
            };
            let shared = sort_downsweep::Interface::shared_bytes(&sort);
            let sorts = sizes.sort_method == SortMethod::Serial || shared <= limits.shared_memory_bytes;
            assert!(sorts && sizes.sort_items > 1, "{lanes} lanes: {shared} bytes, {}", sizes.sort_items);
        }
    }
    assert_eq!([32, 64].map(Requirements::workgroup_invocations), [128, 256]);
    let refused = |lanes| {
        let limits = LimitsOverride {
            fixed_subgroup_size: Some(lanes),
            max_workgroup_invocations: Some(128),
            ..LimitsOverride::default()
        };
        Context::new(&ContextOptions { limits_override: Some(limits), ..options() }).err()
    };
    assert!(refused(32).is_none());
    let said = refused(64).expect("refused").to_string();
    assert_says(&said, &["subgroup size 64", "256", "has 128"]);
}

/// A device whose driver reports a subgroup size and does not let it be required.
fn context_of_fixed_size(size: u32) -> Context {
    limited(LimitsOverride { fixed_subgroup_size: Some(size), ..LimitsOverride::default() })
}

#[test]
fn backends_whose_subgroup_size_cannot_be_required_have_the_same_bits() {
    let gpu = Gpu::new();
    let fixed = context_of_fixed_size(gpu.subgroup());
    assert!(!fixed.limits().subgroup_size_selectable);
    assert!(picture(gpu.context) == picture(&fixed));
}

/// The kernels would give wrong results without an error.
#[test]
fn backends_with_other_subgroups_than_they_report_are_refused() {
    let gpu = Gpu::new();
    let (size, wrong) = (gpu.subgroup(), 2 * gpu.subgroup());
    let context = context_of_fixed_size(wrong);
    let trainer = Run::new(&context, views(2, 5), TrainSettings::reference()).try_begin();
    for said in [refusal(Renderer::new(&context)), refusal(trainer)] {
        assert_says(&said, &[&format!("subgroups of {wrong}"), &format!("with {size} of {size}")]);
    }
}

/// A driver could map invocations to lanes in another order, even with a required size. The test makes the probe
/// report this for ordered lanes.
#[cfg(feature = "hot-reload")]
#[test]
fn backends_with_lanes_in_another_order_are_refused() {
    const PROBE: &str = "subgroups/subgroup_probe";
    let context = Context::new(&options()).expect("a device");
    assert!(context.limits().subgroup_size_selectable, "a driver like most");
    let glsl = crate::common::root().join("glsl");
    let path = glsl.join(format!("{PROBE}.comp"));
    let probe = std::fs::read_to_string(&path).expect("the probe");
    let reversed = probe.replace("+ gl_SubgroupInvocationID,", "+ size - 1 - gl_SubgroupInvocationID,");
    assert_ne!(probe, reversed);
    let compile = ashsplat::kernels::compile::compile;
    let spirv = compile(&glsl, &path, PROBE, &reversed, "").expect("a shader");
    context.replace_shader(PROBE, Some(spirv));
    let size = context.limits().subgroup_size;
    let place = format!("invocation 0 was at {} of its workgroup, in a subgroup that begins at 0", size - 1);
    assert_says(refusal(Renderer::new(&context)), &[&format!("subgroups of {size}"), &place]);
    context.replace_shader(PROBE, None);
    Renderer::new(&context).expect("subgroups are as they should be");
    assert_silent(&context);
}
