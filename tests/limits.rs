//! Lowered limits and little memory give the same picture and training, or an error with the numbers.

use crate::common::device::{assert_uses_all, planned_peak};
use crate::common::prelude::*;
use ashsplat::frame::tuning::Backend;
use ashsplat::frame::{FrameBuffers, FrameCapacity, LaunchSizes, PictureCapacity};
use ashsplat::scene::Intrinsics;

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
        ..TrainSettings::reference()
    }
}

fn run(context: &Context, views: Vec<TrainView>) -> Run<'_> {
    Run::new(context, views, settings())
}

fn train(context: &Context) -> Result<Gaussians> {
    let mut trainer = run(context, views(2, 5)).try_begin()?;
    for _ in 0..4 {
        if trainer.step()?.densified.is_some_and(|densified| densified.limited) {
            // Training continues with fewer Gaussians, and reports it.
            let what = "growth".to_owned();
            return Err(Error::TooLarge { what, needed: 1, unit: "Gaussians", limit: 0, limit_name: "" });
        }
    }
    trainer.gaussians()
}

/// Checks that the result is equal or refused. Returns true if equal.
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
    lowered.extend([384_000, 4096].map(|n| LimitsOverride { max_storage_buffer_range: Some(n), ..none }));
    lowered.extend([384_000, 4096].map(|n| LimitsOverride { max_allocation_bytes: Some(n), ..none }));
    // On a GPU a sort's digits take 256 workgroups.
    let side = if gpu.context.limits().tuning.backend == Backend::Gpu { 16 } else { 8 };
    lowered.extend([100, side, 1].map(|n| LimitsOverride { max_workgroups_per_axis: Some(n), ..none }));
    lowered.extend([128, 8].map(|n| LimitsOverride { max_workgroup_invocations: Some(n), ..none }));
    lowered.extend([16 << 10, 64].map(|n| LimitsOverride { shared_memory_bytes: Some(n), ..none }));
    lowered.extend([128, 32].map(|n| LimitsOverride { push_constant_bytes: Some(n), ..none }));
    lowered.extend([4, 1].map(|n| LimitsOverride { max_workgroup_subgroups: Some(n), ..none }));
    lowered.extend([32, 4].map(|n| LimitsOverride { max_push_descriptors: Some(n), ..none }));
    // Dozens of blending dispatches instead of one.
    lowered.push(LimitsOverride { instances_per_dispatch: Some(150), ..none });
    let (mut equal, mut refused) = (0, 0);
    for limits in lowered {
        let context = limited(limits);
        let results = [
            equal_or_refused("render", limits, &picture, render(&context)),
            equal_or_refused("train", limits, &trained, train(&context)),
        ];
        let same = results.iter().filter(|equal| **equal).count();
        equal += same;
        refused += results.len() - same;
        eprintln!("{limits:?}: render, train: {results:?}");
        assert_silent(&context);
    }
    assert!(equal >= 15 && refused >= 8, "{equal} equal, {refused} refused");
    // Without texels, other kernels compute the loss and round differently, but the picture is the same.
    let context = limited(LimitsOverride { max_texels: Some(4096), ..none });
    assert!(render(&context).expect("a picture") == picture);
    assert_silent(&context);
}

/// 8K frames do not fit bindings of 128 MiB.
#[test]
fn limits_of_large_images_are_named() {
    let context = with_range(128 << 20);
    let mut renderer = loaded(&context, &start());
    let lens = Intrinsics::from_fov_x(0.8, 7680, 4320);
    let large = Camera::look_at(Vec3::NEG_Z * 4.0, Vec3::ZERO, Vec3::NEG_Y, lens);
    let refused = renderer.render(&large, &RenderSettings::default());
    let words = ["7680x4320", "accumulated", "530841600", "134217728", "maxStorageBufferRange"];
    assert_says(refusal(refused), &words);
    // The renderer still draws pictures that fit.
    renderer.render(&camera(&small_view([33, 18])), &RenderSettings::default()).expect("a frame");
    assert_silent(&context);
}

/// A picture that can be drawn can be trained on: no buffer of the backward pass needs more bytes per pixel than the
/// picture.
#[test]
fn limits_of_images_are_those_of_the_picture_in_training_too() {
    let largest = 128 << 20;
    let context = with_range(largest);
    for (width, height) in [(4096, 2048), (2048, 4096), (2896, 2896), (3840, 2160)] {
        let capacity = FrameCapacity {
            gaussians: 1000,
            visible: 1000,
            instances: 5000,
            pictures: PictureCapacity::of(width, height),
            backward: true,
            ..FrameCapacity::default()
        };
        for (name, bytes) in FrameBuffers::requests(&capacity, &LaunchSizes::new(context.limits())) {
            assert!(bytes <= largest, "{width}x{height}: {name} has {bytes} bytes");
        }
    }
}

/// Gradients lie in one buffer: growth stops when it is full, and a larger start is refused.
#[test]
fn limits_of_bindings_stop_growth_not_training() {
    let mut start = gaussians(&small_scene(&mut Random::new(42), 3000, 16));
    // Small Gaussians, so that instances are no limit here.
    start.log_scales.iter_mut().flatten().for_each(|s| *s -= 2.5);
    let settings = || TrainSettings { densify_grad_threshold: 0.0, ..settings() };
    let context = with_range(5000 * 64);
    let mut trainer =
        Run { start: start.clone(), settings: settings(), ..run(&context, views(2, 5)) }.begin();
    assert!(trainer.steps(8).iter().filter_map(|r| r.densified).any(|densified| densified.limited));
    assert!((3000..=5000).contains(&trainer.trained().len()));
    let few = with_range(2900 * 64);
    let refused = Run { start, settings: settings(), ..run(&few, views(2, 5)) }.try_begin();
    assert_says(refusal(refused), &["3000 Gaussians, more than 2900"]);
}

/// Bindings that hold 3840 instances; each Gaussian covers all six tiles.
#[test]
fn limits_of_instances_stop_growth_and_lose_nothing() {
    let context = with_range(3840 * 16);
    let run = |context, count| Run {
        start: large(count),
        settings: TrainSettings { densify_grad_threshold: 0.0, ..settings() },
        ..run(context, views(2, 5))
    };
    // Twice as many would not fit.
    let reports = run(&context, 450).begin().steps(6);
    let max = reports.iter().map(|r| r.instances).max();
    assert!(max > Some(2000) && max <= Some(3840), "{max:?}");
    assert!(reports.iter().any(|r| r.densified.is_some_and(|d| d.limited)));
    // Too many from the start: an error with the numbers, and a checkpoint that resumes on a larger device.
    let mut trainer = run(&context, 900).begin();
    assert_too_many_instances(trainer.step());
    let gpu = Gpu::new();
    run(gpu.context, 900).resume(&trainer.state()).steps(1);
    drop(trainer);
    assert_silent(&context);
}

/// Gaussians that cover all tiles.
fn large(count: usize) -> Gaussians {
    let mut many = gaussians(&small_scene(&mut Random::new(43), count, 16));
    many.log_scales.iter_mut().flatten().for_each(|s| *s += 2.0);
    many
}

fn assert_too_many_instances<T>(result: Result<T>) {
    let error = result.err().expect("too many");
    assert!(matches!(error, Error::TooLarge { .. }) && error.to_string().contains("instances"), "{error}");
}

/// Number of instances that bindings hold.
const FEW: u32 = 4608;

/// A device with such bindings: [`large`] Gaussians fit them in a view of six tiles, but not of twelve.
fn crowded() -> Context {
    with_range(u64::from(FEW) * 16)
}

/// Two views that fit, and a large one.
fn mixed(context: &Context, settings: TrainSettings) -> Run<'_> {
    let views = vec![view_of([40, 30]), view_of([64, 48]), view_of([40, 30])];
    Run { start: large(450), settings, ..run(context, views) }
}

/// Training skips a view whose frames are too large, trains the others, and does not grow meanwhile. A resumed run
/// has the same bits.
#[test]
fn limits_of_instances_leave_out_the_views_beyond_them() {
    let context = crowded();
    let begin = |seed| {
        let run = mixed(&context, TrainSettings { densify_grad_threshold: 0.0, seed, ..settings() });
        let mut trainer = run.begin();
        let first = trainer.step();
        (trainer, first, run)
    };
    // A run that starts with the large view is refused, because no view is known to fit.
    let refused = (0..20).find_map(|seed| begin(seed).1.err()).expect("one of the seeds");
    assert!(matches!(refused, Error::TooLarge { .. }), "{refused}");
    let (mut trainer, _, run) =
        (0..20).map(begin).find(|(_, first, _)| first.is_ok()).expect("one of the seeds");
    let (mut skipped, mut trained, mut checkpoints) = (0, 0, Vec::new());
    for _ in 0..11 {
        checkpoints.push(trainer.state());
        let report = trainer.steps(1).remove(0);
        assert_eq!(report.skipped, report.view == 1, "{report:?}");
        assert_eq!(report.skipped, report.instances > FEW && report.loss.is_nan(), "{report:?}");
        let same = checkpoints.last().is_some_and(|before| before.gaussians == trainer.trained());
        let grown = report.densified;
        if skipped > 0
            && let Some(densified) = grown
        {
            assert!(densified.limited && densified.rows() <= densified.before, "{densified:?}");
        }
        if report.skipped {
            assert!(same || grown.is_some(), "an iteration that was left out has changed something");
            skipped += 1;
        } else {
            trained += u32::from(!same);
        }
    }
    assert!(skipped >= 3 && trained >= 2, "{skipped} {trained}");
    let end = trainer.state();
    for checkpoint in checkpoints.iter().step_by(3) {
        let mut resumed = run.resume(checkpoint);
        resumed.steps(end.iteration - checkpoint.iteration);
        assert!(resumed.state() == end, "resumed at {}", checkpoint.iteration);
    }
    drop(trainer);
    assert_silent(&context);
}

#[test]
fn limits_of_instances_leave_out_the_last_iteration_of_a_run() {
    let context = crowded();
    let with = |seed, iterations| {
        let settings = TrainSettings { densify_grad_threshold: 0.0, seed, iterations, ..settings() };
        mixed(&context, settings)
    };
    let train = |run: &Run| {
        let mut trainer = run.begin();
        let steps: Result<Vec<_>> = (0..run.settings.iterations).map(|_| trainer.step()).collect();
        steps.map(|reports| (trainer.state(), reports))
    };
    let tries = (0..20).map(|seed| (seed, train(&with(seed, 9))));
    let (seed, (end, reports)) =
        tries.filter_map(|(seed, run)| Some((seed, run.ok()?))).next().expect("one of the seeds");
    let longer = with(seed, 9);
    let mut tried = 0;
    for last in reports[..8].iter().filter(|r| r.skipped || r.iteration % 3 == 0) {
        let (checkpoint, parts) = train(&with(seed, last.iteration)).expect("a shorter run");
        assert_eq!((parts[parts.len() - 1].skipped, checkpoint.skipped > 0), (last.skipped, last.skipped));
        let mut resumed = longer.resume(&checkpoint);
        resumed.finish();
        assert!(resumed.state() == end, "a run of {}: other bits", last.iteration);
        tried += u32::from(last.skipped);
    }
    assert!(tried >= 2, "{tried}");
    assert_silent(&context);
}

#[test]
fn limits_of_instances_end_a_training_of_nothing() {
    let context = crowded();
    let run = |context| run(context, vec![view_of([64, 48]); 2]).starting_at(&large(450));
    let gpu = Gpu::new();
    let mut checkpoint = run(gpu.context).until(1, &[]);
    for _ in 0..2 {
        // Resuming in between makes no difference.
        let mut trainer = run(&context).resume(&checkpoint);
        assert!(trainer.steps(1)[0].skipped);
        checkpoint = trainer.state();
    }
    let mut trainer = run(&context).resume(&checkpoint);
    assert_too_many_instances(trainer.step());
    // The scene remains available, and resumes on a larger device.
    assert!(!run(gpu.context).resume(&trainer.state()).steps(1)[0].skipped);
    drop(trainer);
    assert_silent(&context);
}

#[test]
fn memory_that_cannot_suffice_is_said_before_any_work() {
    let context = bounded(Some(200_000));
    let refused = run(&context, views(2, 5)).try_begin().err().expect("refused");
    assert!(matches!(refused, Error::TooLarge { limit: 200_000, .. }), "{refused}");
    let words = ["150 Gaussians of SH degree 3", "2 photographs", "--max-memory"];
    assert_says(refused.to_string(), &words);
    assert_eq!(context.memory_total().peak_bytes, 0, "nothing was allocated");
    drop(context);
    // The needed memory suffices, and less does not.
    let Error::TooLarge { needed, .. } = refused else { unreachable!("asserted above") };
    assert!(run(&bounded(Some(needed - 1)), views(2, 5)).try_begin().is_err());
    let context = bounded(Some(needed));
    let mut trainer = run(&context, views(2, 5)).begin();
    trainer.steps(1);
    assert_uses_all(&context, needed);
    trainer.steps(4);
}

/// Drawing larger and fuller pictures during a training does not change its growth. They are drawn even if training uses all
/// memory, provided that they fit in place of its frame.
#[test]
fn memory_budget_is_trainings_whoever_looks_on() {
    let start = gaussians(&small_scene(&mut Random::new(44), 3000, 16));
    let settings = TrainSettings { densify_grad_threshold: 1e-7, ..settings() };
    let train = |max_memory: Option<u64>, looked_at: bool| {
        let context = bounded(max_memory);
        let run = Run { start: start.clone(), settings: settings.clone(), ..run(&context, views(2, 5)) };
        let mut trainer = run.begin();
        let picture = RenderSettings { scale_modifier: 1.5, ..trainer.render_settings() };
        let (mut limited, mut seen) = (0, 0);
        for i in 0..10 {
            limited += u32::from(trainer.steps(1)[0].densified.is_some_and(|d| d.limited));
            if looked_at {
                let size = [[40, 30], [160, 90], [64, 48]][i % 3];
                seen += u32::from(trainer.render(&camera(&small_view(size)), &picture).is_ok());
            }
        }
        let end = trainer.state();
        drop(trainer);
        assert_silent(&context);
        let max = context.memory_total().peak_bytes;
        (end, limited, [max, planned_peak(&context)], seen)
    };
    let (free, none, [_, peak], _) = train(None, false);
    assert_eq!(none, 0);
    let bytes = Some(peak * 55 / 100);
    let (alone, limited, _, _) = train(bytes, false);
    assert!(limited > 0 && alone.gaussians.len() < free.gaussians.len(), "{limited}");
    let (looked_at, also_limited, [max, _], seen) = train(bytes, true);
    assert!(looked_at == alone && also_limited == limited, "looking on changes what is grown");
    assert!(Some(max) <= bytes && seen == 10, "{max} bytes, {seen} pictures");
}
