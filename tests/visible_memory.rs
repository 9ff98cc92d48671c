//! Training whose memory depends on the visible Gaussians: views that show more than estimated, within bounds.

use crate::common::device::kept_for_transfers;
use crate::common::prelude::*;
use crate::common::training::{forecast, photo_size};
use ashsplat::frame::initial_visible;
use ashsplat::scene::Bounds;
use ashsplat::train::{Capacities, MomentsType, SceneBlock};

const SIZE: [u32; 2] = [64, 48];
const COUNT: u32 = 24_000;
const MIB: u64 = 1 << 20;

/// Small Gaussians. One camera sees few of them, the other all.
fn scene() -> Gaussians {
    let mut scene = gaussians(&small_scene(&mut Random::new(78), COUNT as usize, 1));
    scene.log_scales.iter_mut().flatten().for_each(|s| *s -= 2.0);
    scene
}

fn views() -> Vec<TrainView> {
    let all = camera(&small_view(SIZE));
    let few = Camera { translation: all.translation + Vec3::X * 3.0, ..all };
    let [width, height] = SIZE;
    let photo =
        |k: u32| Photo { width, height, rgb: (0..width * height * 3).map(|i| (i * k) as u8).collect() };
    vec![TrainView::new(few, photo(7)), TrainView::new(all, photo(5))]
}

fn settings() -> TrainSettings {
    TrainSettings { iterations: 8, sh_degree: 1, ..TrainSettings::of_strategy(StrategyType::Reference) }
}

fn run(context: &Context, settings: TrainSettings) -> Run<'_> {
    Run::new(context, views(), settings).starting_at(&scene())
}

fn needed(settings: &TrainSettings) -> u64 {
    let photos = vec![photo_size("a", SIZE); 2];
    forecast(settings, &photos, [COUNT, 0], &bounded(Some(1))).0
}

/// Trains with the memory that the error names, and with more. For some bounds a reserve of Gaussians fits beside an
/// estimated frame, but not beside the frame that shows all.
#[test]
fn every_view_is_trained_within_the_memory_that_is_asked_for() {
    let settings = settings();
    let expected = {
        let context = bounded(None);
        let mut trainer = run(&context, settings.clone()).begin();
        let reports = trainer.steps(8);
        let visible = |view: usize| reports.iter().filter(|r| r.view == view).map(|r| r.visible).max();
        let [few, all] = [visible(0), visible(1)].map(|visible| visible.expect("both views"));
        assert!((1..initial_visible(COUNT)).contains(&few) && all > COUNT / 4 * 3, "{few} {all}");
        trainer.state().fingerprint()
    };
    let min_memory = needed(&settings);
    for more in (0..14).step_by(2) {
        let context = bounded(Some(min_memory + more * MIB));
        let mut trainer = run(&context, settings.clone()).begin();
        assert!(trainer.steps(8).iter().all(|report| !report.skipped), "{more} MiB more");
        assert!(trainer.state().fingerprint() == expected, "{more} MiB more");
    }
}

/// Repeated steps give the bits of frames with enough capacity from the start, also with other features that use frames.
#[test]
fn steps_that_are_run_again_leave_the_bits_of_others() {
    let usual = TrainSettings { iterations: 12, ..settings() };
    let growing = TrainSettings {
        scale_schedule: false,
        densify_from_iter: 2,
        densification_interval: 3,
        densify_until_iter: 9,
        ..TrainSettings::of_strategy(StrategyType::Budget)
    };
    for settings in [
        TrainSettings { exposure: true, pose_opt: true, filter_3d: true, ..usual.clone() },
        TrainSettings { iterations: 12, sh_degree: 1, dropout: 0.1, ..growing },
    ] {
        let run = run(context(), settings);
        let mut started = run.begin();
        let mut from = started.state();
        from.capacities = Capacities {
            frame_gaussians: from.capacities.gaussians,
            frame_visible: from.capacities.gaussians,
            frame_instances: 1 << 20,
            blend_passes: 1,
            ..from.capacities
        };
        let mut roomy = run.resume(&from);
        let mut repeated = false;
        for iteration in 1..=12 {
            let [ours, theirs] = [&mut started, &mut roomy].map(|trainer| trainer.steps(1).remove(0));
            let counts = |report: &StepReport| (report.loss, report.visible, report.instances);
            assert_eq!(counts(&ours), counts(&theirs));
            repeated |= ours.visible > initial_visible(COUNT);
            let [ours, theirs] = [&started, &roomy].map(|trainer| trainer.state().fingerprint());
            assert!(ours == theirs, "iteration {iteration}");
        }
        assert!(repeated, "no frame had less room than it needed");
    }
}

/// Guard bands keep all buffers apart. The bits of trainings with densification are the same.
#[test]
fn sharing_memory_changes_no_bit() {
    let budget = TrainSettings::of_strategy(StrategyType::Budget);
    let mcmc = TrainSettings { cap_max: 26_000, ..TrainSettings::of_strategy(StrategyType::Mcmc) };
    let all = [
        TrainSettings { pose_opt: true, moments: MomentsType::Packed, ..budget },
        TrainSettings { exposure: true, lens_opt: true, filter_3d: true, ..TrainSettings::reference() },
        TrainSettings { surface: true, ..mcmc },
    ];
    for settings in all {
        let settings = TrainSettings {
            iterations: 12,
            sh_degree: 1,
            scale_schedule: false,
            densify_from_iter: 2,
            densification_interval: 3,
            densify_until_iter: 9,
            ..settings
        };
        let [shared, apart] = [false, true].map(|guard_bands| {
            let context = Context::new(&ContextOptions { guard_bands, ..options() }).expect("a device");
            let mut trainer = run(&context, settings.clone()).begin();
            let reports = trainer.steps(12);
            assert!(reports.iter().any(|report| report.densified.is_some()));
            assert!(context.breached_guards().expect("read").is_empty());
            assert_silent(&context);
            (trainer.state().fingerprint(), arena_peak(&context, "frame"))
        });
        assert!(shared.0 == apart.0, "{:?}", settings.strategy);
        assert!(shared.1 * 4 < apart.1 * 3, "{} bytes, apart {}", shared.1, apart.1);
    }
}

/// Settings whose seed begins twice with the view that shows few Gaussians.
fn few_first() -> TrainSettings {
    let first = |seed: u32| {
        let settings = TrainSettings { seed, ..settings() };
        run(context(), settings).begin().steps(1)[0].view
    };
    let seed = (0..16).find(|&seed| first(seed) == 0).expect("one of 16");
    TrainSettings { seed, ..settings() }
}

/// The reserve of Gaussians is freed in the middle of a run, too, with its moments and statistics.
#[test]
fn a_reserve_gives_way_to_a_frame_in_the_middle_of_a_run() {
    let few_first = few_first();
    let TrainSettings { seed, iterations, sh_degree, .. } = few_first;
    let budget = TrainSettings {
        seed,
        iterations,
        sh_degree,
        scale_schedule: false,
        filter_3d: true,
        exposure: true,
        ..TrainSettings::of_strategy(StrategyType::Budget)
    };
    let packed =
        TrainSettings { moments: MomentsType::Packed, sh_storage: ShStorage::Half, ..budget.clone() };
    let poses = TrainSettings { pose_opt: true, ..budget };
    for settings in [few_first, packed, poses] {
        a_reserve_gives_way(&settings);
    }
}

fn a_reserve_gives_way(settings: &TrainSettings) {
    let train = |ballast: Option<u64>| {
        let context = bounded(Some(96 * MIB));
        let mut trainer = run(&context, settings.clone()).begin();
        let first = trainer.steps(1).remove(0);
        assert!(first.view == 0 && first.visible < initial_visible(COUNT), "{first:?}");
        let reserved = trainer.state().capacities.gaussians;
        // Another user takes memory.
        let held = ballast.map(|left| {
            context.free_staging();
            let bytes = 96 * MIB - context.memory_total().bytes - kept_for_transfers(&context) - left;
            context.allocate("ballast", &[("ballast", bytes)], MemoryKind::Device).expect("memory")
        });
        let reports = trainer.steps(5);
        assert!(reports.iter().all(|report| !report.skipped), "{reports:?}");
        let after = trainer.state();
        drop(held);
        (after.fingerprint(), reserved, after.capacities.gaussians)
    };
    let (expected, reserved, kept) = train(None);
    assert!(reserved > COUNT && kept == reserved);
    let (trained, _, kept) = train(Some(0));
    assert_eq!(kept, COUNT, "the reserve was kept");
    assert!(trained == expected, "other bits");
}

#[test]
fn a_view_that_shows_too_much_stops_growth() {
    let grows = TrainSettings {
        scale_schedule: false,
        densify_from_iter: 2,
        densification_interval: 3,
        densify_grad_threshold: 0.0,
        ..few_first()
    };
    let train = |bound: Option<u64>| run(&bounded(bound), grows.clone()).begin().steps(6);
    let free = train(None);
    assert!(free.iter().all(|report| !report.skipped) && free[5].gaussians > COUNT, "{free:?}");
    let all = free.iter().find(|report| report.view == 1).expect("the view");
    // Enough for the estimate, which exceeds the number of instances.
    let min_memory = needed(&grows);
    let mut tight = (1..16).map(|less| train(Some(min_memory - less * MIB / 2)));
    let tight = tight.find(|reports| reports.iter().any(|report| report.skipped)).expect("a bound");
    for report in &tight {
        assert_eq!((report.skipped, report.gaussians), (report.view == 1, COUNT), "{report:?}");
        let estimate = f64::from(report.instances) / f64::from(all.instances);
        let is_known = report.visible == all.visible && (0.5..2.0).contains(&estimate);
        assert!(!report.skipped || is_known, "{report:?}");
    }
}

/// After an exchange, the trainer expects a frame like the previous ones. If that does not fit, training continues
/// without the expectation.
#[test]
fn what_is_expected_after_an_exchange_is_no_reason_to_refuse() {
    let settings = settings();
    let from = {
        let gpu = Gpu::new();
        let mut from = run(gpu.context, settings.clone()).until(4, &[]);
        let block = SceneBlock {
            core: Bounds { min: Vec3::NEG_INFINITY, max: Vec3::INFINITY },
            frozen: Gaussians::default(),
            chosen_from: None,
        };
        from.settle_in(&block);
        from
    };
    assert!(from.capacities.frame_visible > COUNT / 2 && from.capacities.gaussians == 0);
    let resumed = |bound: Option<u64>| {
        let context = bounded(bound);
        let mut trainer = run(&context, settings.clone()).resume(&from);
        let skipped = trainer.steps(4).iter().any(|report| report.skipped);
        (trainer.state().fingerprint(), skipped)
    };
    let (expected, _) = resumed(None);
    let min_memory = needed(&settings);
    for bound in [0, 1, 2, 3, 5, 8, 13].map(|more| min_memory + more * MIB) {
        assert_eq!(resumed(Some(bound)), (expected, false), "{bound}");
    }
    // With less memory than requested, the result is that without the expectation.
    let unknown = Checkpoint { capacities: Capacities::default(), ..from.clone() };
    for bound in (1..12).map(|less| min_memory - less * MIB) {
        let resumes = |from| run(&bounded(Some(bound)), settings.clone()).try_resume(from).is_ok();
        let [with, without] = [&from, &unknown].map(resumes);
        assert_eq!(with, without, "{bound}");
    }
}
