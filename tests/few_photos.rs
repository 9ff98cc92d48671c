//! Features for few photographs: dropout of Gaussians, and the depths of sparse points.

use crate::common::prelude::*;
use crate::common::training::settings as small_settings;
use ashsplat::passes::loss::DepthPoint;

fn settings() -> TrainSettings {
    TrainSettings { dropout: 0.3, depth_points: 0.2, ..small_settings() }
}

/// Three views; the second has no points.
pub fn few() -> Vec<TrainView> {
    let points = |view: u32| -> Vec<DepthPoint> {
        let point = |k: u32| DepthPoint {
            position_px: [(k * (view + 5) % 39) as f32 + 0.25, (k * 11 % 29) as f32 + 0.5],
            inverse_z: 0.15 + 0.01 * (k % 9) as f32,
        };
        (0..30).map(point).collect()
    };
    let with = |(index, view): (u32, TrainView)| match index {
        1 => view,
        _ => TrainView { depth_points: Some(points(index).into()), ..view },
    };
    (0..).zip(views(3, 40)).map(with).collect()
}

fn run(settings: TrainSettings) -> Run<'static> {
    Run::shared(few(), settings)
}

#[test]
fn few_photos_resume_to_the_bit() {
    for strategy in [small_settings().strategy, StrategyType::Mcmc] {
        let run = run(TrainSettings { strategy, ..settings() });
        run.check_stops(&[&[], &[1], &[15], &[27]]);
        // Views with other points are different views.
        let mut views = few();
        views[0].depth_points = views[2].depth_points.clone();
        let checkpoint = run.begin().state();
        assert_says(refusal(Run { views, ..run }.try_resume(&checkpoint)), &["other photographs"]);
    }
}

/// The same three views with maps instead of points; the second has none.
pub fn mapped() -> Vec<TrainView> {
    let map =
        |view: u32| (0..40 * 30).map(|k| 0.2 + 0.001 * ((k * (view + 3)) % 97) as f32).collect::<Vec<f32>>();
    let with = |(index, view): (u32, TrainView)| match index {
        1 => view,
        _ => TrainView { inverse_depth: Some(map(index).into()), ..view },
    };
    (0..).zip(views(3, 40)).map(with).collect()
}

#[test]
fn inverse_depth_maps_resume_to_the_bit() {
    let run = |views| Run { views, ..run(TrainSettings { depth_points: 0.0, ..settings() }) };
    let end = run(mapped()).check_stops(&[&[], &[1], &[15], &[27]]);
    assert!(run(views(3, 40)).end(&[]).gaussians != end.gaussians, "without effect");
    // Views with other maps are different views.
    let mut other = mapped();
    other[0].inverse_depth = other[2].inverse_depth.clone();
    let checkpoint = run(mapped()).begin().state();
    assert_says(refusal(run(other).try_resume(&checkpoint)), &["other photographs"]);
}

#[test]
fn few_photos_settings_have_an_effect_each() {
    let off = TrainSettings { dropout: 0.0, depth_points: 0.0, ..settings() };
    let end = |settings| run(settings).end(&[]).gaussians;
    let plain = end(off.clone());
    let without = Run { views: views(3, 40), ..run(off.clone()) };
    assert!(without.end(&[]).gaussians == plain);
    let dropped = end(TrainSettings { dropout: 0.3, ..off.clone() });
    let deep = end(TrainSettings { depth_points: 0.2, ..off });
    assert!(dropped != plain && deep != plain && dropped != deep);
    // Another seed drops other Gaussians, even if nothing else is random.
    let other = |seed: u32| {
        let fixed = TrainSettings { strategy: StrategyType::Fixed, random_background: false, ..settings() };
        let views = few().into_iter().take(1).collect();
        let settings = TrainSettings { seed, depth_points: 0.0, ..fixed };
        Run { views, ..run(settings) }.until(10, &[]).gaussians
    };
    assert!(other(1) != other(2));
}

/// Dropped Gaussians count as not visible, and reports include the loss term.
#[test]
fn few_photos_leave_gaussians_out_of_steps_and_not_of_pictures() {
    let settings = TrainSettings { dropout: 0.9, strategy: StrategyType::Fixed, ..settings() };
    let mut trainer = run(settings).begin();
    let reports = trainer.finish();
    let seen = |reports: &[StepReport]| reports.iter().map(|report| report.visible).sum::<u32>();
    let [first, last] = [&reports[..3], &reports[36..39]].map(seen);
    // Nine of ten are dropped at the end.
    assert!(5 * last < first, "{last} {first}");
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
    let difference = |depth_points: f64| {
        let settings = TrainSettings {
            depth_points,
            dropout: 0.0,
            strategy: StrategyType::Fixed,
            iterations: 200,
            opacity_reset_interval: 100_000,
            ..settings()
        };
        let mut trainer = run(settings.clone()).begin();
        let weight = |iteration| settings.depth_points_weight(iteration) as f32 * EXTENT;
        let mean = |report: &StepReport| report.terms[1].1 / weight(report.iteration);
        let of_view = |reports: &[StepReport]| {
            reports.iter().filter(|report| report.view == 0).map(mean).sum::<f32>() / 2.0
        };
        let reports = trainer.steps(192);
        (of_view(&reports[..6]), of_view(&reports[186..]))
    };
    let ((_, without), (before, with)) = (difference(1e-9), difference(2.0));
    assert!(with < 0.7 * before && with < 0.7 * without, "{before} {with} {without}");
}

#[test]
fn few_photos_refuse_what_contradicts() {
    let refused = |views: Vec<TrainView>, settings: TrainSettings, start: &str, word: &str| {
        let message = refusal(Run { views, ..run(settings) }.try_begin());
        assert!(message.starts_with(start) && message.contains(word), "{message}");
    };
    refused(views(3, 40), settings(), "depth_points: ", "none");
    let map = |view: TrainView| TrainView { inverse_depth: Some(vec![0.5; 40 * 30].into()), ..view };
    refused(few().into_iter().map(map).collect(), settings(), "depth_points: ", "-d");
    let mut outside = few();
    outside[2].depth_points = Some(vec![DepthPoint { position_px: [39.5, 3.0], inverse_z: 1.0 }].into());
    refused(outside, settings(), "view 2: ", "40x30");
    refused(few(), TrainSettings { dropout: 1.0, ..settings() }, "dropout: is 1", "");
}
