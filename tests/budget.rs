//! Training with budgeted growth, and its parts that the reference's strategy can use.

use ashsplat::densify::RESET_OPACITY;
use ashsplat::trainer::{Checkpoint, ImportanceType, OptimizerType, SplitType, StrategyType, Trainer};
use ashsplat::vk::Context;
use ashsplat::{Gaussians, TrainSettings};
use ashsplat_files::CheckpointFile;

use crate::checkpoints::{check_growth_in_bounded_memory, start, views};
use crate::common::gpu::Gpu;
use crate::reference::linear::sigmoid;
use crate::reference::schedule::quantile;

const EXTENT: f32 = 5.0;
const CAP: u32 = 260;

/// 60 iterations: densifies after 15, 20, … 35, resets opacities after 20 and 40.
fn settings() -> TrainSettings {
    TrainSettings {
        iterations: 60,
        sh_degree: 2,
        sh_degree_interval: 12,
        scale_sh_degree: false,
        scale_schedule: false,
        densify_from_iter: 10,
        densification_interval: 5,
        densify_until_iter: 38,
        opacity_reset_interval: 20,
        densify_grad_threshold: 1e-5,
        cap_max: CAP,
        seed: 6,
        ..TrainSettings::of_strategy(StrategyType::Budget)
    }
}

/// The last third, of 18 iterations, has steps of 5 and of 20 views: groups begin at 40 and at 48.
fn in_groups() -> TrainSettings {
    TrainSettings {
        iterations: 60,
        scale_schedule: true,
        densify_from_iter: 5000,
        densify_until_iter: 19_000,
        ..settings()
    }
}

fn trainer(context: &Context, settings: &TrainSettings) -> Trainer {
    Trainer::new(context, views(4, 9), &start(), EXTENT, settings.clone()).expect("a trainer")
}

fn refused(settings: TrainSettings) -> String {
    let gpu = Gpu::new();
    let refused = Trainer::new(gpu.context, views(1, 9), &start(), EXTENT, settings);
    let message = refused.err().expect("refused").to_string();
    assert_eq!(message.lines().count(), 1, "{message}");
    message
}

#[test]
fn budget_splits_up_to_its_curve() {
    let gpu = Gpu::new();
    for importance in [ImportanceType::Edges, ImportanceType::Statistic, ImportanceType::None] {
        let settings = TrainSettings { importance, ..settings() };
        let mut trainer = trainer(gpu.context, &settings);
        let (mut reports, mut split) = (vec![], 0);
        for iteration in 1..=60 {
            let report = trainer.step().expect("a step");
            assert!(report.loss.is_finite() && report.skipped_non_finite == 0, "{iteration}");
            if let Some(densified) = report.densified {
                assert_eq!(densified.cloned, 0);
                assert_eq!(densified.rows(), report.gaussians);
                assert!(!densified.limited, "{iteration}");
                split += densified.split;
                reports.push((iteration - 1, densified));
            }
        }
        let after: Vec<u32> = reports.iter().map(|(iteration, _)| *iteration).collect();
        assert_eq!(after, [15, 20, 25, 30, 35]);
        for (iteration, densified) in reports {
            let schedule = ashsplat::trainer::GrowthSchedule::of(&settings, start().len() as u32);
            let budget = schedule.budget(iteration).max(densified.before);
            assert!(densified.rows() <= budget, "{iteration}: {densified:?}, {budget}");
        }
        assert!(split > 30, "{split} splits");
    }
}

/// Each switch changes the result of a run.
#[test]
fn budget_has_a_switch_for_each_part() {
    let gpu = Gpu::new();
    let end = |settings: TrainSettings| {
        let mut trainer = trainer(gpu.context, &settings);
        (0..60).for_each(|_| drop(trainer.step().expect("a step")));
        trainer.gaussians().expect("Gaussians")
    };
    type Change = fn(&mut TrainSettings);
    // With the statistic, so that all parts have an effect.
    let by_statistic = || TrainSettings { importance: ImportanceType::Statistic, ..in_groups() };
    let whole = end(by_statistic());
    let changes: [Change; 10] = [
        |s| s.absgrad = false,
        |s| s.scale_rates = false,
        |s| s.scale_sh_degree = true,
        |s| s.cap_max = 0,
        |s| s.split = SplitType::Sample,
        |s| s.importance = ImportanceType::Edges,
        |s| s.importance = ImportanceType::None,
        |s| s.growth_curve = false,
        |s| s.recovery = false,
        |s| s.multi_step = false,
    ];
    for (number, change) in changes.into_iter().enumerate() {
        let mut settings = by_statistic();
        change(&mut settings);
        assert!(end(settings) != whole, "change {number} changes nothing");
    }
}

#[test]
fn budget_resumes_to_the_bit() {
    let gpu = Gpu::new();
    let run = |settings: &TrainSettings, stops: &[u32]| -> Checkpoint {
        let mut trainer = trainer(gpu.context, settings);
        for iteration in 1..=60 {
            trainer.step().expect("a step");
            if stops.contains(&iteration) {
                let checkpoint = trainer.checkpoint().expect("a checkpoint");
                let folder = tempfile::tempdir().expect("a temporary folder");
                let path = folder.path().join("c.safetensors");
                checkpoint.write(&path).expect("written");
                let read = Checkpoint::read(&path).expect("read");
                assert!(read == checkpoint, "the file of {iteration}");
                let resumed = Trainer::resume(gpu.context, views(4, 9), EXTENT, settings.clone(), &read);
                trainer = resumed.expect("resumed");
            }
        }
        trainer.checkpoint().expect("the end")
    };
    let plain = settings();
    let whole = run(&plain, &[]);
    // Around densifications, and between a reset and the next densification.
    for stops in [[7, 15], [20, 23], [34, 35]] {
        assert!(run(&plain, &stops) == whole, "interrupted after {stops:?}: other bits");
    }
    // Within sums: 40 and 45 make steps, 48 begins groups of 20.
    let grouped = in_groups();
    let whole = run(&grouped, &[]);
    assert!(whole.gradient_sums.is_some(), "the last iteration makes no step");
    for stops in [[41, 44], [45, 52], [59, 47]] {
        assert!(run(&grouped, &stops) == whole, "interrupted after {stops:?}: other bits");
    }
    // With exposures and poses, which also sum views.
    let lit = TrainSettings { exposure: true, pose_opt: true, pose_lr: 1e-3, ..in_groups() };
    let whole = run(&lit, &[]);
    let sums = whole.gradient_sums.as_ref().expect("the last iteration makes no step");
    assert_eq!((sums.light.exposures.len(), sums.poses.len()), (4, 4));
    for stops in [[18, 43], [45, 52]] {
        assert!(run(&lit, &stops) == whole, "interrupted after {stops:?}: other bits");
    }
}

/// Each view of a step contributes to its own exposure and pose, not only the last view. Nothing moves between
/// steps.
#[test]
fn budget_adds_up_exposures_and_poses() {
    let gpu = Gpu::new();
    let settings = TrainSettings { exposure: true, pose_opt: true, pose_lr: 1e-3, ..in_groups() };
    let mut trainer = trainer(gpu.context, &settings);
    (0..40).for_each(|_| drop(trainer.step().expect("a step")));
    let before = trainer.checkpoint().expect("a state");
    let mut seen = [false; 4];
    for iteration in 41..=45 {
        seen[trainer.step().expect("a step").view] = true;
        let after = trainer.checkpoint().expect("a state");
        let moved = after.exposures != before.exposures || after.poses != before.poses;
        assert_eq!(moved, iteration == 45, "{iteration}");
    }
    assert_eq!(seen, [true; 4]);
    let after = trainer.checkpoint().expect("a state");
    // A second moment without a gradient decreases by a thousandth.
    let grown = |before: &[f32], after: &[f32]| before.iter().zip(after).any(|(b, a)| *a > 0.99901 * b);
    let [first, last] = [&before, &after].map(|state| state.poses.as_ref().expect("poses"));
    for view in 0..4 {
        let [b, a] = [&before, &after].map(|state| state.exposures.second_moments[view].as_flattened());
        assert!(grown(b, a), "the exposure of view {view} has no gradient");
        let (b, a) = (&first.second_moments[view], &last.second_moments[view]);
        assert!(grown(b, a), "the pose of view {view} has no gradient");
    }
}

/// A step after several views uses the sum of their gradients. Nothing moves between steps.
#[test]
fn budget_makes_one_step_of_several_views() {
    let gpu = Gpu::new();
    let mut trainer = trainer(gpu.context, &in_groups());
    let mut moved = vec![];
    let mut before = trainer.gaussians().expect("Gaussians");
    for iteration in 1..=60 {
        trainer.step().expect("a step");
        let after = trainer.gaussians().expect("Gaussians");
        if after != before {
            moved.push(iteration);
        }
        before = after;
    }
    let expected: Vec<u32> = (1..=39).chain([40, 45]).collect();
    assert_eq!(moved, expected);
    let steps = trainer.checkpoint().expect("a checkpoint").optimizer_steps;
    assert_eq!(steps, 41);
}

/// Number of Gaussians that are not fainter than the faintest fifth.
fn not_of_the_faintest_fifth(all: &Gaussians) -> usize {
    let opacity = |&logit: &f32| sigmoid(logit.into());
    let opacities: Vec<f64> = all.opacity_logits.iter().map(opacity).collect();
    let least = quantile(&opacities, 0.2);
    opacities.iter().filter(|&&opacity| opacity >= least).count()
}

/// With `recovery`, resets are milder, and Gaussians that stay faint are pruned.
#[test]
fn budget_prunes_what_does_not_recover() {
    let gpu = Gpu::new();
    let settings = |recovery: bool| TrainSettings {
        iterations: 1000,
        densify_from_iter: 900,
        densify_until_iter: 990,
        densification_interval: 950,
        opacity_reset_interval: 130,
        recovery,
        ..settings()
    };
    let most = |g: &Gaussians| g.opacity_logits.iter().copied().fold(f32::MIN, f32::max);
    for (recovery, opacity) in [(true, 0.05), (false, RESET_OPACITY)] {
        let mut trainer = trainer(gpu.context, &settings(recovery));
        let mut counts = vec![];
        for iteration in 1..=562 {
            if iteration == 131 {
                let checkpoint = trainer.checkpoint().expect("a checkpoint");
                assert!(checkpoint.due == ashsplat::trainer::Actions::RESET_OPACITY);
            }
            let due = recovery && [431, 561].contains(&iteration);
            let before = due.then(|| trainer.gaussians().expect("Gaussians"));
            let report = trainer.step().expect("a step");
            if iteration == 131 {
                let now = most(&trainer.gaussians().expect("Gaussians"));
                let reset = (opacity / (1.0 - opacity)).ln() as f32;
                assert!((now - reset).abs() < 0.2, "{now}, {reset}");
            }
            if let Some(densified) = report.densified {
                assert_eq!((densified.cloned, densified.split), (0, 0));
                counts.push((iteration - 1, densified.before, densified.kept));
                if let Some(before) = before {
                    assert_eq!(densified.kept as usize, not_of_the_faintest_fifth(&before));
                }
            }
        }
        if !recovery {
            assert_eq!(counts, []);
            continue;
        }
        // 300 after the start, then 300 after each of the first two resets, a fifth each time.
        let after: Vec<u32> = counts.iter().map(|count| count.0).collect();
        assert_eq!(after, [300, 430, 560]);
        // Fewer if many are equally faint: those that no view has seen since the reset.
        for &(_, before, kept) in &counts[1..] {
            assert!(kept < before && before - kept <= before / 5 + 1, "{counts:?}");
        }
    }
}

/// Only Gaussians that are faint late in a run are pruned. A resumed run has the same bits.
#[test]
fn budget_prunes_what_is_faint_late() {
    let gpu = Gpu::new();
    let settings = TrainSettings {
        iterations: 600,
        densify_from_iter: 29_000,
        densify_until_iter: 29_000,
        opacity_reset_interval: 1000,
        scale_schedule: true,
        recovery: false,
        late_min_opacity: 0.1,
        ..settings()
    };
    let mut whole = trainer(gpu.context, &settings);
    let (mut pruned, mut left_off) = (0, None);
    for iteration in 1..=430 {
        let due = [321, 361, 421].contains(&iteration);
        let before = due.then(|| whole.gaussians().expect("Gaussians"));
        if iteration == 361 {
            left_off = Some(whole.checkpoint().expect("a checkpoint"));
        }
        let report = whole.step().expect("a step");
        assert_eq!(report.densified.is_some(), due, "{iteration}");
        let (Some(densified), Some(before)) = (report.densified, before) else { continue };
        // The pruning precedes the step of the next iteration, and uses the Gaussians after the previous one.
        let faint = |logit: f32| 1.0 / (1.0 + f64::from(-logit).exp()) < 0.1;
        let kept: Vec<usize> = (0..before.len()).filter(|&i| !faint(before.opacity_logits[i])).collect();
        assert_eq!((densified.before as usize, densified.kept as usize), (before.len(), kept.len()));
        // They keep their order; one step moves them by less.
        let after = whole.gaussians().expect("Gaussians");
        for (&from, to) in kept.iter().zip(&after.means) {
            let moved = before.means[from].iter().zip(to).map(|(from, to)| (from - to).abs());
            assert!(moved.fold(0.0, f32::max) < 0.01, "{from}");
        }
        pruned += before.len() - kept.len();
    }
    let end = whole.gaussians().expect("Gaussians");
    assert!(pruned > 0 && !end.is_empty(), "{pruned}");
    let left_off = left_off.expect("a checkpoint");
    let mut resumed =
        Trainer::resume(gpu.context, views(4, 9), EXTENT, settings, &left_off).expect("resumed");
    (361..=430).for_each(|_| drop(resumed.step().expect("a step")));
    assert!(resumed.gaussians().expect("Gaussians") == end, "other bits");
}

/// With insufficient memory it grows as far as possible, continues, and is still deterministic.
#[test]
fn budget_grows_as_far_as_the_memory_allows() {
    let settings = TrainSettings {
        cap_max: 1_000_000,
        growth_curve: false,
        densify_grad_threshold: 1e-9,
        min_opacity: 0.0,
        recovery: false,
        densification_interval: 2,
        iterations: 24,
        ..settings()
    };
    check_growth_in_bounded_memory(&settings);
}

#[test]
fn budget_refuses_what_contradicts_itself() {
    let mcmc = TrainSettings { cap_max: 0, ..TrainSettings::of_strategy(StrategyType::Mcmc) };
    assert!(refused(mcmc).contains("cap_max"));
    let message = refused(TrainSettings { cap_max: 0, cap_ratio: 0.9, ..settings() });
    assert!(message.contains("cap_ratio") && message.contains("1 or more"), "{message}");
    let message = refused(TrainSettings { cap_max: 149, ..settings() });
    assert!(message.contains("cap_max") && message.contains("149") && message.contains("150"), "{message}");
    let sparse = OptimizerType::SparseAdam;
    let message = refused(TrainSettings { optimizer_type: sparse, ..settings() });
    assert!(message.contains("multi_step") && message.contains("sparse_adam"), "{message}");
    // Parts that other strategies do not support.
    let usual = TrainSettings::default();
    for (name, strategy) in [
        ("recovery", StrategyType::Reference),
        ("recovery", StrategyType::Mcmc),
        ("recovery", StrategyType::Fixed),
        ("late_min_opacity", StrategyType::Reference),
        ("late_min_opacity", StrategyType::Mcmc),
    ] {
        let late_min_opacity = if name == "late_min_opacity" { 0.1 } else { 0.0 };
        let recovery = name == "recovery";
        let message = refused(TrainSettings { recovery, late_min_opacity, strategy, ..usual.clone() });
        assert!(message.contains(name) && message.contains("budget"), "{message}");
    }
    let message =
        refused(TrainSettings { split: SplitType::LongAxis, strategy: StrategyType::Mcmc, ..usual });
    assert!(message.contains("split") && message.contains("long-axis"), "{message}");
}

/// Both parts in the reference's strategy change the result, are deterministic, and resume to the bit.
#[test]
fn the_reference_strategy_takes_other_statistics_and_splits() {
    let gpu = Gpu::new();
    let run = |absgrad: bool, split: SplitType, stop: Option<u32>| {
        let settings = TrainSettings { absgrad, split, ..crate::checkpoints::settings() };
        let mut trainer = trainer(gpu.context, &settings);
        for iteration in 1..=40 {
            trainer.step().expect("a step");
            if stop == Some(iteration) {
                let from = trainer.checkpoint().expect("a checkpoint");
                trainer = Trainer::resume(gpu.context, views(4, 9), EXTENT, settings.clone(), &from)
                    .expect("resumed");
            }
        }
        trainer.checkpoint().expect("the end")
    };
    let usual = run(false, SplitType::Sample, None);
    for (absgrad, split) in
        [(true, SplitType::Sample), (false, SplitType::LongAxis), (true, SplitType::LongAxis)]
    {
        let whole = run(absgrad, split, None);
        assert!(whole.gaussians != usual.gaussians, "{absgrad} {split:?}");
        assert!(run(absgrad, split, Some(22)) == whole, "{absgrad} {split:?}: other bits");
    }
}

/// Earlier versions called the reference's strategy `default`.
#[test]
fn checkpoints_of_the_strategy_default_go_on() {
    let gpu = Gpu::new();
    let settings = crate::checkpoints::settings();
    let mut first = trainer(gpu.context, &settings);
    (0..12).for_each(|_| drop(first.step().expect("a step")));
    let mut from = first.checkpoint().expect("a checkpoint");
    from.strategy.name = "default".into();
    let mut second = Trainer::resume(gpu.context, views(4, 9), EXTENT, settings, &from).expect("resumed");
    (0..8).for_each(|_| {
        first.step().expect("a step");
        second.step().expect("a step");
    });
    assert!(first.checkpoint().expect("a state") == second.checkpoint().expect("a state"));
}
