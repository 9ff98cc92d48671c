//! Features for few photographs: dropout of Gaussians, and the depths of sparse points.

use ashsplat::loss::DepthPoint;
use ashsplat::trainer::{StrategyType, Trainer};

use ashsplat::{TrainSettings, TrainView};

use crate::checkpoints::{check_resumed_with, end_with, settings as small_settings, start, views};
use crate::common::bounded;
use crate::common::gpu::Gpu;

const EXTENT: f32 = 5.0;
const ITERATIONS: u32 = 40;

fn settings() -> TrainSettings {
    TrainSettings { dropout: 0.3, depth_points: 0.2, iterations: ITERATIONS, ..small_settings() }
}

/// Three views; the second has no points.
fn few() -> Vec<TrainView> {
    let points = |view: u32| -> Vec<DepthPoint> {
        let point = |k: u32| DepthPoint {
            position_px: [(k * (view + 5) % 39) as f32 + 0.25, (k * 11 % 29) as f32 + 0.5],
            inverse_z: 0.15 + 0.01 * (k % 9) as f32,
        };
        (0..30).map(point).collect()
    };
    let with = |(index, view): (u32, TrainView)| match index {
        1 => view,
        _ => view.with_depth_points(Some(points(index).into())),
    };
    (0..).zip(views(3, 40)).map(with).collect()
}

fn trainer(gpu: &Gpu, settings: &TrainSettings) -> Trainer {
    Trainer::new(gpu.context, few(), &start(), EXTENT, settings.clone()).expect("a trainer")
}

#[test]
fn few_photos_resume_to_the_bit() {
    let gpu = Gpu::new();
    for settings in [settings(), TrainSettings { strategy: StrategyType::Mcmc, ..settings() }] {
        check_resumed_with(few, &settings, &[1, 15, 27]);
        // Views with other points are different views.
        let mut other = few();
        other[0].depth_points = other[2].depth_points.clone();
        let checkpoint = trainer(&gpu, &settings).checkpoint().expect("a checkpoint");
        let refused = Trainer::resume(gpu.context, other, EXTENT, settings, &checkpoint);
        assert!(refused.is_err_and(|error| error.to_string().contains("other photographs")));
    }
}

/// The same three views with maps instead of points; the second has none.
fn mapped() -> Vec<TrainView> {
    let map =
        |view: u32| (0..40 * 30).map(|k| 0.2 + 0.001 * ((k * (view + 3)) % 97) as f32).collect::<Vec<f32>>();
    let with = |(index, view): (u32, TrainView)| match index {
        1 => view,
        _ => view.with_inverse_depth(Some(map(index).into())),
    };
    (0..).zip(views(3, 40)).map(with).collect()
}

#[test]
fn inverse_depth_maps_resume_to_the_bit_and_are_within_the_memory() {
    let gpu = Gpu::new();
    let settings = TrainSettings { depth_points: 0.0, ..settings() };
    let end = check_resumed_with(mapped, &settings, &[1, 15, 27]);
    assert!(end_with(views(3, 40), &settings).gaussians != end.gaussians, "without effect");
    // Views with other maps are different views.
    let mut other = mapped();
    other[0].inverse_depth = other[2].inverse_depth.clone();
    let trainer = Trainer::new(gpu.context, mapped(), &start(), EXTENT, settings.clone());
    let checkpoint = trainer.expect("a trainer").checkpoint().expect("a checkpoint");
    let refused = Trainer::resume(gpu.context, other, EXTENT, settings.clone(), &checkpoint);
    assert!(refused.is_err_and(|error| error.to_string().contains("other photographs")));
    let peak = |views: Vec<TrainView>, max_memory: Option<u64>| -> ashsplat::Result<u64> {
        let context = bounded(max_memory);
        let mut trainer = Trainer::new(&context, views, &start(), EXTENT, settings.clone())?;
        (0..3).try_for_each(|_| trainer.step().map(drop))?;
        Ok(context.memory_total().peak_bytes)
    };
    let [without, with] = [views(3, 40), mapped()].map(|views| peak(views, None).expect("trained"));
    assert!(with > without);
    assert!(peak(mapped(), Some(with)).expect("trained") <= with);
}

/// Each setting changes the result; without them, points are ignored.
#[test]
fn few_photos_settings_have_an_effect_each() {
    let gpu = Gpu::new();
    let off = TrainSettings { dropout: 0.0, depth_points: 0.0, ..settings() };
    let plain = end_with(few(), &off);
    let mut without =
        Trainer::new(gpu.context, views(3, 40), &start(), EXTENT, off.clone()).expect("a trainer");
    (0..ITERATIONS).for_each(|_| drop(without.step().expect("a step")));
    assert!(without.checkpoint().expect("the end").gaussians == plain.gaussians);
    let dropped = end_with(few(), &TrainSettings { dropout: 0.3, ..off.clone() });
    let deep = end_with(few(), &TrainSettings { depth_points: 0.2, ..off });
    assert!(dropped.gaussians != plain.gaussians && deep.gaussians != plain.gaussians);
    assert!(dropped.gaussians != deep.gaussians);
    // Another seed drops other Gaussians, even if nothing else is random.
    let other = |seed: u32| {
        let fixed = TrainSettings { strategy: StrategyType::Fixed, random_background: false, ..settings() };
        let one = || few().into_iter().take(1).collect();
        let settings = TrainSettings { seed, depth_points: 0.0, ..fixed };
        let mut trainer = Trainer::new(gpu.context, one(), &start(), EXTENT, settings).expect("a trainer");
        (0..10).for_each(|_| drop(trainer.step().expect("a step")));
        trainer.gaussians().expect("Gaussians")
    };
    assert!(other(1) != other(2));
}

/// Dropped Gaussians count as not visible, and reports include the loss term.
#[test]
fn few_photos_leave_gaussians_out_of_steps_and_not_of_pictures() {
    let gpu = Gpu::new();
    let settings = TrainSettings { dropout: 0.9, strategy: StrategyType::Fixed, ..settings() };
    let mut trainer = trainer(&gpu, &settings);
    let reports: Vec<_> = (0..ITERATIONS).map(|_| trainer.step().expect("a step")).collect();
    let seen =
        |range: std::ops::Range<usize>| reports[range].iter().map(|report| report.visible).sum::<u32>();
    // Nine of ten are dropped at the end.
    assert!(5 * seen(36..39) < seen(0..3), "{} {}", seen(36..39), seen(0..3));
    let terms: Vec<&str> = reports[0].terms.iter().map(|(name, _)| *name).collect();
    assert_eq!(terms, ["photometric", "sparse_depth"]);
    for report in &reports {
        let value = report.terms[1].1;
        assert_eq!(value > 0.0, report.view != 1, "{value}");
    }
    let render = trainer.render_settings();
    let picture = trainer.render(&few()[0].camera, &render).expect("a picture");
    assert!(picture.stats.visible > 2 * reports[38].visible);
}

/// The depths at the points approach their known values.
#[test]
fn few_photos_points_move_the_scene_to_their_depths() {
    let gpu = Gpu::new();
    let difference = |depth_points: f64| {
        let settings = TrainSettings {
            depth_points,
            dropout: 0.0,
            strategy: StrategyType::Fixed,
            iterations: 200,
            opacity_reset_interval: 100_000,
            ..settings()
        };
        let mut trainer = trainer(&gpu, &settings);
        let weight = |iteration| settings.depth_points_weight(iteration) as f32 * EXTENT;
        let mean = |report: &ashsplat::StepReport| report.terms[1].1 / weight(report.iteration);
        let of_view = |trainer: &mut Trainer| {
            let reports: Vec<_> = (0..6).map(|_| trainer.step().expect("a step")).collect();
            reports.iter().filter(|report| report.view == 0).map(mean).sum::<f32>() / 2.0
        };
        let before = of_view(&mut trainer);
        (0..180).for_each(|_| drop(trainer.step().expect("a step")));
        (before, of_view(&mut trainer))
    };
    let ((_, without), (before, with)) = (difference(1e-9), difference(2.0));
    assert!(with < 0.7 * before && with < 0.7 * without, "{before} {with} {without}");
}

#[test]
fn few_photos_are_within_the_memory() {
    let peak = |depth_points: f64, max_memory: Option<u64>| -> ashsplat::Result<u64> {
        let context = bounded(max_memory);
        let settings = TrainSettings { depth_points, ..settings() };
        let mut trainer = Trainer::new(&context, few(), &start(), EXTENT, settings)?;
        (0..3).try_for_each(|_| trainer.step().map(drop))?;
        Ok(context.memory_total().peak_bytes)
    };
    let (without, with) = (peak(0.0, None).expect("trained"), peak(0.2, None).expect("trained"));
    assert!(with > without);
    assert!(peak(0.2, Some(with)).expect("trained") <= with);
    let refused = peak(0.2, Some(50_000)).expect_err("too little").to_string();
    assert!(refused.contains("bytes"), "{refused}");
}

#[test]
fn few_photos_refuse_what_contradicts() {
    let gpu = Gpu::new();
    let refused = |views: Vec<TrainView>, settings: TrainSettings| {
        let refused = Trainer::new(gpu.context, views, &start(), EXTENT, settings);
        refused.err().expect("refused").to_string()
    };
    let message = refused(views(3, 40), settings());
    assert!(message.starts_with("depth_points: ") && message.contains("none"), "{message}");
    let mapped =
        few().into_iter().map(|view| view.with_inverse_depth(Some(vec![0.5; 40 * 30].into()))).collect();
    let message = refused(mapped, settings());
    assert!(message.starts_with("depth_points: ") && message.contains("-d"), "{message}");
    let mut outside = few();
    outside[2].depth_points = Some(vec![DepthPoint { position_px: [39.5, 3.0], inverse_z: 1.0 }].into());
    let message = refused(outside, settings());
    assert!(message.starts_with("view 2: ") && message.contains("40x30"), "{message}");
    let message = refused(few(), TrainSettings { dropout: 1.0, ..settings() });
    assert!(message.starts_with("dropout: is 1"), "{message}");
}
