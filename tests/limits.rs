//! Lowered limits and little memory: the same picture and the same training, or an error that names the numbers.

use ashsplat::scene::{Camera, Intrinsics};
use ashsplat::trainer::Trainer;
use ashsplat::vk::{Context, ContextOptions, LimitsOverride};
use ashsplat::{Error, Gaussians, RenderSettings, Renderer, Result, TrainSettings};
use glam::Vec3;

use crate::checkpoints::{start, views};
use crate::common::engine::{camera, gaussians};
use crate::common::gpu::Gpu;
use crate::common::scenes::{Random, small_scene, small_view};
use crate::common::{assert_silent, options};

fn context(limits: LimitsOverride) -> Context {
    Context::new(&ContextOptions { limits_override: Some(limits), ..options() }).expect("a device")
}

fn render(context: &Context) -> Result<Vec<[f32; 3]>> {
    let mut renderer = Renderer::new(context)?;
    renderer.upload(&gaussians(&small_scene(&mut Random::new(77), 700, 16)))?;
    Ok(renderer.render(&camera(&small_view([200, 120])), &RenderSettings::default())?.color)
}

/// Densifies after the second iteration.
fn settings() -> TrainSettings {
    TrainSettings {
        sh_degree_interval: 2,
        densify_from_iter: 1,
        densification_interval: 2,
        densify_grad_threshold: 1e-6,
        ..TrainSettings::default()
    }
}

fn train(context: &Context) -> Result<Gaussians> {
    let mut trainer = Trainer::new(context, views(2, 5), &start(), 5.0, settings())?;
    for _ in 0..4 {
        trainer.step()?;
    }
    trainer.gaussians()
}

/// An equal result, or a refusal: which of the two.
fn equal_or_refused<T: PartialEq>(name: &str, limits: LimitsOverride, usual: &T, result: Result<T>) -> bool {
    match result {
        Ok(result) => {
            assert!(result == *usual, "{name}: another result with {limits:?}");
            true
        }
        Err(Error::TooLarge { .. }) => false,
        Err(error) => panic!("{name} with {limits:?}: {error}"),
    }
}

#[test]
fn limits_that_are_lowered_change_no_bit_or_are_named() {
    let gpu = Gpu::new();
    let (picture, trained) =
        (render(gpu.context).expect("a picture"), train(gpu.context).expect("Gaussians"));
    let none = LimitsOverride::default();
    let mut lowered = Vec::new();
    lowered.extend(
        [384_000, 61_440, 4096].map(|n| LimitsOverride { max_storage_buffer_range: Some(n), ..none }),
    );
    lowered.extend([384_000, 4096].map(|n| LimitsOverride { max_allocation_bytes: Some(n), ..none }));
    lowered.extend([100, 8, 1].map(|n| LimitsOverride { max_workgroups_per_axis: Some(n), ..none }));
    lowered.extend([128, 8].map(|n| LimitsOverride { max_workgroup_invocations: Some(n), ..none }));
    lowered.extend([16 << 10, 64].map(|n| LimitsOverride { shared_memory_bytes: Some(n), ..none }));
    lowered.extend([128, 32].map(|n| LimitsOverride { push_constant_bytes: Some(n), ..none }));
    lowered.extend([4, 1].map(|n| LimitsOverride { max_workgroup_subgroups: Some(n), ..none }));
    lowered.extend([32, 4].map(|n| LimitsOverride { max_push_descriptors: Some(n), ..none }));
    let (mut equal, mut refused) = (0, 0);
    for limits in lowered {
        let context = context(limits);
        let results = [
            equal_or_refused("render", limits, &picture, render(&context)),
            equal_or_refused("train", limits, &trained, train(&context)),
        ];
        equal += results.iter().filter(|equal| **equal).count();
        refused += results.iter().filter(|equal| !**equal).count();
        eprintln!("{limits:?}: render, train: {results:?}");
        assert_silent(&context);
    }
    assert!(equal >= 13 && refused >= 8, "{equal} equal, {refused} refused");
    // Without texels, the loss is by other kernels, which round otherwise: a picture is the same.
    let context = context(LimitsOverride { max_texels: Some(4096), ..none });
    assert!(render(&context).expect("a picture") == picture);
    assert_silent(&context);
}

/// 8K frames do not fit bindings of 128 MiB.
#[test]
fn limits_of_large_images_are_named() {
    let context =
        context(LimitsOverride { max_storage_buffer_range: Some(128 << 20), ..LimitsOverride::default() });
    let mut renderer = Renderer::new(&context).expect("a renderer");
    renderer.upload(&start()).expect("upload");
    let lens = Intrinsics::from_fov_x(0.8, 7680, 4320);
    let camera = Camera::look_at(Vec3::NEG_Z * 4.0, Vec3::ZERO, Vec3::NEG_Y, lens);
    let message = renderer.render(&camera, &RenderSettings::default()).expect_err("too large").to_string();
    for word in ["7680x4320", "accumulated", "530841600", "134217728", "maxStorageBufferRange"] {
        assert!(message.contains(word), "no '{word}' in {message}");
    }
    assert_silent(&context);
}

/// Gradients lie in one buffer: growth ends where it does, and more than it holds is refused at once.
#[test]
fn limits_of_bindings_stop_growth_not_training() {
    let limits = |gaussians: u64| LimitsOverride {
        max_storage_buffer_range: Some(gaussians * 64),
        ..LimitsOverride::default()
    };
    let mut start = gaussians(&small_scene(&mut Random::new(42), 3000, 16));
    // Small ones: that there is room for instances is not what is asked here.
    start.log_scales.iter_mut().flatten().for_each(|s| *s -= 2.5);
    let settings = TrainSettings { densify_grad_threshold: 0.0, ..settings() };
    let context = context(limits(5000));
    let mut trainer = Trainer::new(&context, views(2, 5), &start, 5.0, settings.clone()).expect("a trainer");
    let densified = (0..8).filter_map(|_| trainer.step().expect("a step").densified);
    assert!(densified.filter(|d| d.limited).count() > 0);
    assert!((3000..=5000).contains(&trainer.gaussians().expect("Gaussians").len()));
    let few = self::context(limits(2900));
    let refused = Trainer::new(&few, views(2, 5), &start, 5.0, settings).err().expect("refused").to_string();
    assert!(refused.contains("3000 Gaussians, more than 2900"), "{refused}");
}

/// Bindings that hold 3840 instances; Gaussians that each cover all six tiles.
#[test]
fn limits_of_instances_stop_growth_and_lose_nothing() {
    let limits = LimitsOverride { max_storage_buffer_range: Some(3840 * 16), ..LimitsOverride::default() };
    let large = |count| {
        let mut many = gaussians(&small_scene(&mut Random::new(43), count, 16));
        many.log_scales.iter_mut().flatten().for_each(|s| *s += 2.0);
        many
    };
    let context = context(limits);
    let settings = TrainSettings { densify_grad_threshold: 0.0, ..settings() };
    // Twice as many would not fit.
    let mut trainer =
        Trainer::new(&context, views(2, 5), &large(450), 5.0, settings.clone()).expect("a trainer");
    let reports: Vec<_> = (0..6).map(|_| trainer.step().expect("a step")).collect();
    let most = reports.iter().map(|r| r.instances).max();
    assert!(most > Some(2000) && most <= Some(3840), "{most:?}");
    assert!(reports.iter().any(|r| r.densified.is_some_and(|d| d.limited)));
    drop(trainer);
    // Too many from the start: an error that names them, and a checkpoint that goes on where there is room.
    let mut trainer =
        Trainer::new(&context, views(2, 5), &large(900), 5.0, settings.clone()).expect("a trainer");
    let error = trainer.step().expect_err("too many");
    assert!(matches!(error, Error::TooLarge { .. }) && error.to_string().contains("instances"), "{error}");
    let checkpoint = trainer.checkpoint().expect("a checkpoint");
    let gpu = Gpu::new();
    let resumed = Trainer::resume(gpu.context, views(2, 5), 5.0, settings, &checkpoint);
    resumed.expect("resumed").step().expect("there is room here");
    drop(trainer);
    assert_silent(&context);
}

fn with_memory(bytes: u64) -> Context {
    Context::new(&ContextOptions { max_memory: Some(bytes), ..options() }).expect("a device")
}

#[test]
fn memory_that_cannot_suffice_is_said_before_any_work() {
    let context = with_memory(200_000);
    let refused = Trainer::new(&context, views(2, 5), &start(), 5.0, settings()).err().expect("refused");
    assert!(matches!(refused, Error::TooLarge { limit: 200_000, .. }), "{refused}");
    let message = refused.to_string();
    for word in ["150 Gaussians of SH degree 3", "2 photographs", "--max-memory"] {
        assert!(message.contains(word), "no '{word}' in {message}");
    }
    assert_eq!(context.memory_total().peak_bytes, 0, "nothing was allocated");
}

/// With memory for the start and no more, training goes on without growing; what was enough before is enough now.
#[test]
fn memory_budget_stops_growth_not_training() {
    let start = gaussians(&small_scene(&mut Random::new(41), 6000, 16));
    let settings = TrainSettings { densify_grad_threshold: 0.0, min_opacity: 0.3, ..settings() };
    let train = |context: &Context| {
        let mut trainer =
            Trainer::new(context, views(2, 5), &start, 5.0, settings.clone()).expect("a trainer");
        let mut densified = Vec::new();
        for _ in 0..8 {
            densified.extend(trainer.step().expect("a step").densified);
        }
        (densified, trainer.gaussians().expect("Gaussians").len(), context.memory_total().peak_bytes)
    };
    let gpu = Gpu::new();
    let (free, grown, _) = train(gpu.context);
    assert!(free.iter().all(|d| !d.limited) && grown > 9000, "{free:?}, {grown}");
    // Room for the sets of 6000 Gaussians, half as many again, and the frame; not for twice the sets.
    let sets = 9000 * (4 * 240 + 8);
    let context = with_memory(sets * 9 / 5);
    let (limited, kept, peak) = train(&context);
    assert!(limited.iter().any(|d| d.limited), "{limited:?}");
    // As many as there is room for: those with the largest gradients.
    assert!(limited.iter().any(|d| d.limited && d.cloned + d.split > 0), "{limited:?}");
    for d in limited.iter().filter(|d| d.limited) {
        assert!((8800..=9000).contains(&d.rows()), "{d:?}");
    }
    assert!(kept <= 9000 && peak <= sets * 9 / 5, "{kept} Gaussians, {peak} bytes");
    assert_silent(&context);
}
