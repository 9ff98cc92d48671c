//! Lowered limits and little memory give the same picture and training, or an error with the numbers.

use ashsplat::plan::{FrameCapacity, LaunchSizes, PictureCapacity, ScenePlan, frame_requests};
use ashsplat::scene::{Camera, Intrinsics};
use ashsplat::trainer::{Checkpoint, TrainView, Trainer};
use ashsplat::tuning::Backend;
use ashsplat::vk::{Context, ContextOptions, LimitsOverride};
use ashsplat::{Error, Gaussians, RenderSettings, Renderer, Result, TrainSettings};
use ashsplat_files::Photo;
use glam::Vec3;

use crate::checkpoints::{start, views};
use crate::common::device::{Bounded, assert_uses_all, bounded, planned_peak};
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
    assert!(equal >= 15 && refused >= 8, "{equal} equal, {refused} refused");
    // Without texels, other kernels compute the loss and round differently, but the picture is the same.
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

/// A picture that can be drawn can be trained on: no buffer of the backward pass needs more bytes per pixel than the
/// picture.
#[test]
fn limits_of_images_are_those_of_the_picture_in_training_too() {
    let largest = 128 << 20;
    let context =
        context(LimitsOverride { max_storage_buffer_range: Some(largest), ..LimitsOverride::default() });
    for (width, height) in [(4096, 2048), (2048, 4096), (2896, 2896), (3840, 2160)] {
        let capacity = FrameCapacity {
            gaussians: 1000,
            visible: 1000,
            instances: 5000,
            scenes: 1,
            pictures: PictureCapacity::of(width, height),
            blend_passes: 1,
            backward: true,
            absolute: false,
        };
        for (name, bytes) in frame_requests(&capacity, &LaunchSizes::new(context.limits())) {
            assert!(bytes <= largest, "{width}x{height}: {name} has {bytes} bytes");
        }
    }
}

/// Gradients lie in one buffer: growth stops when it is full, and a larger start is refused.
#[test]
fn limits_of_bindings_stop_growth_not_training() {
    let limits = |gaussians: u64| LimitsOverride {
        max_storage_buffer_range: Some(gaussians * 64),
        ..LimitsOverride::default()
    };
    let mut start = gaussians(&small_scene(&mut Random::new(42), 3000, 16));
    // Small Gaussians, so that instances are no limit here.
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

/// Bindings that hold 3840 instances; each Gaussian covers all six tiles.
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
    // Too many from the start: an error with the numbers, and a checkpoint that resumes on a larger device.
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

/// Number of instances that bindings hold.
const FEW: u32 = 4608;

/// A device with such bindings, and Gaussians that cover all tiles: six in one view, twelve in the other.
fn crowded() -> (Context, Gaussians) {
    let range = u64::from(FEW) * 16;
    let limits = LimitsOverride { max_storage_buffer_range: Some(range), ..LimitsOverride::default() };
    let mut scene = gaussians(&small_scene(&mut Random::new(43), 450, 16));
    scene.log_scales.iter_mut().flatten().for_each(|s| *s += 2.0);
    (context(limits), scene)
}

fn view_of(size: [u32; 2]) -> TrainView {
    let [width, height] = size;
    let rgb = (0..width * height * 3).map(|k| (k * 7) as u8).collect();
    TrainView::new(camera(&small_view(size)), Photo { width, height, rgb })
}

/// Training skips a view whose frames are too large, trains the others, and does not grow meanwhile. A resumed run
/// has the same bits.
#[test]
fn limits_of_instances_leave_out_the_views_beyond_them() {
    let (context, scene) = crowded();
    let views = || vec![view_of([40, 30]), view_of([64, 48]), view_of([40, 30])];
    let wanted = TrainSettings { densify_grad_threshold: 0.0, ..settings() };
    let begin = |seed| {
        let settings = TrainSettings { seed, ..wanted.clone() };
        let mut trainer = Trainer::new(&context, views(), &scene, 5.0, settings.clone()).expect("a trainer");
        let first = trainer.step();
        (trainer, first, settings)
    };
    // A run that starts with the large view is refused, because no view is known to fit.
    let refused = (0..20).find_map(|seed| begin(seed).1.err()).expect("one of the seeds");
    assert!(matches!(refused, Error::TooLarge { .. }), "{refused}");
    let (mut trainer, _, settings) =
        (0..20).map(begin).find(|(_, first, _)| first.is_ok()).expect("one of the seeds");
    let (mut skipped, mut trained, mut checkpoints) = (0, 0, Vec::new());
    for _ in 0..11 {
        let before = trainer.gaussians().expect("Gaussians");
        checkpoints.push(trainer.checkpoint().expect("a checkpoint"));
        let report = trainer.step().expect("a step");
        assert_eq!(report.skipped, report.view == 1, "{report:?}");
        assert_eq!(report.skipped, report.instances > FEW && report.loss.is_nan(), "{report:?}");
        let (same, grown) = (trainer.gaussians().expect("Gaussians") == before, report.densified);
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
    let end = trainer.checkpoint().expect("the end");
    for checkpoint in checkpoints.iter().step_by(3) {
        let resumed = Trainer::resume(&context, views(), 5.0, settings.clone(), checkpoint);
        let mut resumed = resumed.expect("resumed");
        while resumed.iteration() < trainer.iteration() {
            resumed.step().expect("a step");
        }
        assert!(resumed.checkpoint().expect("the end") == end, "resumed at {}", checkpoint.iteration);
    }
    drop(trainer);
    assert_silent(&context);
}

/// A run whose last iteration was skipped resumes like a longer run.
#[test]
fn limits_of_instances_leave_out_the_last_iteration_of_a_run() {
    let (context, scene) = crowded();
    let views = || vec![view_of([40, 30]), view_of([64, 48]), view_of([40, 30])];
    let wanted = TrainSettings { densify_grad_threshold: 0.0, iterations: 9, ..settings() };
    let run = |settings: &TrainSettings| {
        let mut trainer = Trainer::new(&context, views(), &scene, 5.0, settings.clone()).expect("a trainer");
        let steps: Result<Vec<_>> = (0..settings.iterations).map(|_| trainer.step()).collect();
        steps.map(|reports| (trainer.checkpoint().expect("a checkpoint"), reports))
    };
    let seeds = (0..20).map(|seed| TrainSettings { seed, ..wanted.clone() });
    let (longer, (end, reports)) =
        seeds.filter_map(|s| run(&s).ok().map(|ran| (s, ran))).next().expect("one of the seeds");
    let mut tried = 0;
    for last in reports[..8].iter().filter(|r| r.skipped || r.iteration % 3 == 0) {
        let short = TrainSettings { iterations: last.iteration, ..longer.clone() };
        let (checkpoint, parts) = run(&short).expect("a shorter run");
        assert_eq!((parts[parts.len() - 1].skipped, checkpoint.skipped > 0), (last.skipped, last.skipped));
        // Older checkpoints lack this field.
        for skipped in [checkpoint.skipped, 0] {
            let from = Checkpoint { skipped, ..checkpoint.clone() };
            let resumed = Trainer::resume(&context, views(), 5.0, longer.clone(), &from);
            let mut resumed = resumed.expect("resumed");
            while resumed.iteration() < longer.iterations {
                resumed.step().expect("a step");
            }
            assert!(resumed.checkpoint().expect("the end") == end, "a run of {}: other bits", last.iteration);
        }
        tried += u32::from(last.skipped);
    }
    assert!(tried >= 2, "{tried}");
    assert_silent(&context);
}

/// If no view fits any more, training ends with the reason.
#[test]
fn limits_of_instances_end_a_training_of_nothing() {
    let (context, scene) = crowded();
    let views = || vec![view_of([64, 48]), view_of([64, 48])];
    let gpu = Gpu::new();
    let mut trainer = Trainer::new(gpu.context, views(), &scene, 5.0, settings()).expect("a trainer");
    trainer.step().expect("there is room here");
    let checkpoint = trainer.checkpoint().expect("a checkpoint");
    let mut trainer = Trainer::resume(&context, views(), 5.0, settings(), &checkpoint).expect("resumed");
    for _ in 0..2 {
        // Interruptions do not matter.
        let checkpoint = trainer.checkpoint().expect("a checkpoint");
        trainer = Trainer::resume(&context, views(), 5.0, settings(), &checkpoint).expect("resumed");
        assert!(trainer.step().expect("left out").skipped);
    }
    let checkpoint = trainer.checkpoint().expect("a checkpoint");
    let mut trainer = Trainer::resume(&context, views(), 5.0, settings(), &checkpoint).expect("resumed");
    let error = trainer.step().expect_err("nothing is trained");
    assert!(matches!(error, Error::TooLarge { .. }) && error.to_string().contains("instances"), "{error}");
    // The scene remains available, and resumes on a larger device.
    let checkpoint = trainer.checkpoint().expect("a checkpoint");
    let mut resumed = Trainer::resume(gpu.context, views(), 5.0, settings(), &checkpoint).expect("resumed");
    assert!(!resumed.step().expect("there is room here").skipped);
    drop(trainer);
    assert_silent(&context);
}

fn with_memory(bytes: u64) -> Bounded {
    bounded(Some(bytes))
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
    drop(context);
    // The needed memory suffices, and less does not.
    let Error::TooLarge { needed, .. } = refused else { unreachable!("asserted above") };
    assert!(Trainer::new(&with_memory(needed - 1), views(2, 5), &start(), 5.0, settings()).is_err());
    let context = with_memory(needed);
    let trainer = Trainer::new(&context, views(2, 5), &start(), 5.0, settings());
    let mut trainer = trainer.expect("as much as was asked for");
    trainer.step().expect("a step");
    assert_uses_all(&context, needed);
    for _ in 0..4 {
        trainer.step().expect("a step");
    }
}

/// With memory for the start only, training continues without growth. Memory that sufficed before suffices now.
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
    // Memory for the sets of 6000 Gaussians, half as many again, and the frame; not for twice the sets.
    let sets = 9000 * (4 * 240 + 8);
    let context = with_memory(sets * 9 / 5);
    let (limited, kept, peak) = train(&context);
    assert!(limited.iter().any(|d| d.limited), "{limited:?}");
    // Growth adds as many as fit, chosen by the largest gradients.
    assert!(limited.iter().any(|d| d.limited && d.cloned + d.split > 0), "{limited:?}");
    for d in limited.iter().filter(|d| d.limited) {
        assert!((8800..=9000).contains(&d.rows()), "{d:?}");
    }
    assert!(kept <= 9000 && peak <= sets * 9 / 5, "{kept} Gaussians, {peak} bytes");
    assert_silent(&context);
}

/// Drawing pictures larger and fuller than those of training does not change its growth. They are drawn however much
/// memory training uses, if they fit in place of its frame.
#[test]
fn memory_budget_is_trainings_whoever_looks_on() {
    let start = gaussians(&small_scene(&mut Random::new(44), 3000, 16));
    let settings = TrainSettings { densify_grad_threshold: 1e-7, ..settings() };
    let train = |max_memory: Option<u64>, looked_at: bool| {
        let context = bounded(max_memory);
        let mut trainer =
            Trainer::new(&context, views(2, 5), &start, 5.0, settings.clone()).expect("a trainer");
        let picture = RenderSettings { scale_modifier: 1.5, ..trainer.render_settings() };
        let (mut limited, mut seen) = (0, 0);
        for i in 0..10 {
            limited += u32::from(trainer.step().expect("a step").densified.is_some_and(|d| d.limited));
            if looked_at {
                let size = [[40, 30], [160, 90], [64, 48]][i % 3];
                seen += u32::from(trainer.render(&camera(&small_view(size)), &picture).is_ok());
            }
        }
        let end = trainer.checkpoint().expect("the end");
        drop(trainer);
        assert_silent(&context);
        let most = context.memory_total().peak_bytes;
        (end, limited, [most, planned_peak(&context)], seen)
    };
    let (free, none, [_, peak], _) = train(None, false);
    assert_eq!(none, 0);
    for share in [55, 62, 70] {
        let bytes = Some(peak * share / 100);
        let (alone, limited, _, _) = train(bytes, false);
        assert!(limited > 0 && alone.gaussians.len() < free.gaussians.len(), "{share} %: {limited}");
        let (looked_at, also_limited, [most, _], seen) = train(bytes, true);
        assert!(looked_at == alone && also_limited == limited, "{share} %: looking on changes what is grown");
        assert!(Some(most) <= bytes && seen == 10, "{share} %: {most} bytes, {seen} pictures");
    }
}

/// Every vec4 of a chunk belongs to one plane of one Gaussian, and a row of a plane is contiguous.
#[test]
fn limits_of_a_chunk_hold_every_plane_once() {
    let gpu = Gpu::new();
    for (sh_degree, planes) in [(0, 4), (1, 6), (2, 10), (3, 15)] {
        let plan = ScenePlan::new(gpu.context.limits(), 700, sh_degree).expect("a plan");
        assert_eq!((plan.chunk_gaussians, plan.planes), (768, planes));
        let mut owners = vec![0; 768 * planes as usize];
        for (plane, index) in (0..planes).flat_map(|plane| (0..768).map(move |index| (plane, index))) {
            let place = plan.place(plane, index);
            assert_eq!(place, crate::common::layout::place(plane, index, 768), "{plane}, {index}");
            owners[place] += 1;
            assert_eq!(place - plan.place(plane, index - index % 8), index % 8);
        }
        assert!(owners.iter().all(|&count| count == 1), "{plan:?}");
    }
}
