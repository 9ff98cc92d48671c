//! Training with budgeted growth, and its parts that the reference's strategy can use.

use crate::checkpoints::check_growth_in_bounded_memory;
use crate::common::prelude::*;
use crate::reference::linear::sigmoid;
use crate::reference::schedule::quantile;
use ashsplat::passes::densify::RESET_OPACITY;
use ashsplat::train::{ImportanceType, SplitType};

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

/// The same densifications, in shares of 30,000 iterations.
fn scaled() -> TrainSettings {
    TrainSettings {
        iterations: 60,
        scale_schedule: true,
        densify_from_iter: 5000,
        densify_until_iter: 19_000,
        ..settings()
    }
}

fn run(settings: &TrainSettings) -> Run<'static> {
    Run::shared(views(4, 9), settings.clone())
}

fn trainer(settings: &TrainSettings) -> Trainer {
    run(settings).begin()
}

fn refused(settings: TrainSettings, words: &[&str]) {
    let message = refusal(Run::shared(views(1, 9), settings).try_begin());
    assert_eq!(message.lines().count(), 1, "{message}");
    assert_says(&message, words);
}

#[test]
fn budget_splits_up_to_its_curve() {
    for importance in [ImportanceType::Edges, ImportanceType::Statistic, ImportanceType::None] {
        let settings = TrainSettings { importance, ..settings() };
        let schedule = ashsplat::train::GrowthSchedule::of(&settings, start().len() as u32);
        let (mut after, mut split) = (vec![], 0);
        for report in trainer(&settings).finish() {
            assert!(report.loss.is_finite() && report.skipped_non_finite == 0, "{report:?}");
            let Some(densified) = report.densified else { continue };
            let iteration = report.iteration - 1;
            assert_eq!((densified.cloned, densified.rows()), (0, report.gaussians));
            let budget = schedule.budget(iteration).max(densified.before);
            assert!(!densified.limited && densified.rows() <= budget, "{report:?}, {budget}");
            split += densified.split;
            after.push(iteration);
        }
        assert_eq!(after, [15, 20, 25, 30, 35]);
        assert!(split > 30, "{split} splits");
    }
}

#[test]
fn budget_has_a_switch_for_each_part() {
    let end = |settings: TrainSettings| run(&settings).end(&[]).gaussians;
    type Change = fn(&mut TrainSettings);
    // With the statistic, so that all parts have an effect.
    let by_statistic = || TrainSettings { importance: ImportanceType::Statistic, ..scaled() };
    let whole = end(by_statistic());
    let changes: [Change; 9] = [
        |s| s.absgrad = false,
        |s| s.scale_rates = false,
        |s| s.scale_sh_degree = true,
        |s| s.cap_max = 0,
        |s| s.split = SplitType::Sample,
        |s| s.importance = ImportanceType::Edges,
        |s| s.importance = ImportanceType::None,
        |s| s.growth_curve = false,
        |s| s.recovery = false,
    ];
    for (number, change) in changes.into_iter().enumerate() {
        let mut settings = by_statistic();
        change(&mut settings);
        assert!(end(settings) != whole, "change {number} changes nothing");
    }
}

#[test]
fn budget_resumes_to_the_bit() {
    // Around densifications, and between a reset and the next densification.
    run(&settings()).check_stops(&[&[7, 15], &[20, 23], &[34, 35]]);
    let lit = TrainSettings { exposure: true, pose_opt: true, pose_lr: 1e-3, ..scaled() };
    run(&lit).check_stops(&[&[18, 43]]);
}

fn not_of_the_faintest_fifth(all: &Gaussians) -> usize {
    let opacity = |&logit: &f32| sigmoid(logit.into());
    let opacities: Vec<f64> = all.opacity_logits.iter().map(opacity).collect();
    let min_opacity = quantile(&opacities, 0.2);
    opacities.iter().filter(|&&opacity| opacity >= min_opacity).count()
}

/// With `recovery`, resets are milder, and Gaussians that stay faint are pruned.
#[test]
fn budget_prunes_what_does_not_recover() {
    let settings = |recovery: bool| TrainSettings {
        iterations: 1000,
        densify_from_iter: 900,
        densify_until_iter: 990,
        densification_interval: 950,
        opacity_reset_interval: 130,
        recovery,
        ..settings()
    };
    let max_logit = |g: &Gaussians| g.opacity_logits.iter().copied().fold(f32::MIN, f32::max);
    for (recovery, opacity) in [(true, 0.05), (false, RESET_OPACITY)] {
        let mut trainer = trainer(&settings(recovery));
        let mut counts = vec![];
        for iteration in 1..=562 {
            if iteration == 131 {
                assert!(trainer.state().due == ashsplat::train::Actions::RESET_OPACITY);
            }
            let due = recovery && [431, 561].contains(&iteration);
            let before = due.then(|| trainer.trained());
            let report = trainer.step().expect("a step");
            if iteration == 131 {
                let now = max_logit(&trainer.trained());
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
        // A fifth is pruned 300 iterations after the start, and 300 after each of the first two resets.
        let after: Vec<u32> = counts.iter().map(|count| count.0).collect();
        assert_eq!(after, [300, 430, 560]);
        // Fewer are pruned if many are equally faint, because no view has seen them since the reset.
        for &(_, before, kept) in &counts[1..] {
            assert!(kept < before && before - kept <= before / 5 + 1, "{counts:?}");
        }
    }
}

#[test]
fn budget_prunes_what_is_faint_late() {
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
    let run = run(&settings);
    let mut whole = run.begin();
    let (mut pruned, mut left_off) = (0, None);
    for iteration in 1..=430 {
        let due = [321, 361, 421].contains(&iteration);
        let before = due.then(|| whole.trained());
        if iteration == 361 {
            left_off = Some(whole.state());
        }
        let report = whole.step().expect("a step");
        assert_eq!(report.densified.is_some(), due, "{iteration}");
        let (Some(densified), Some(before)) = (report.densified, before) else { continue };
        // The pruning precedes the step of the next iteration, and uses the Gaussians after the previous one.
        let faint = |logit: f32| 1.0 / (1.0 + f64::from(-logit).exp()) < 0.1;
        let kept: Vec<usize> = (0..before.len()).filter(|&i| !faint(before.opacity_logits[i])).collect();
        assert_eq!((densified.before as usize, densified.kept as usize), (before.len(), kept.len()));
        // They keep their order; one step moves them by less.
        let after = whole.trained();
        for (&from, to) in kept.iter().zip(&after.means) {
            let moved = before.means[from].iter().zip(to).map(|(from, to)| (from - to).abs());
            assert!(moved.fold(0.0, f32::max) < 0.01, "{from}");
        }
        pruned += before.len() - kept.len();
    }
    let end = whole.trained();
    assert!(pruned > 0 && !end.is_empty(), "{pruned}");
    let mut resumed = run.resume(&left_off.expect("a checkpoint"));
    resumed.steps(70);
    assert!(resumed.trained() == end, "other bits");
}

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
    refused(mcmc, &["cap_max"]);
    refused(TrainSettings { cap_max: 0, cap_ratio: 0.9, ..settings() }, &["cap_ratio", "1 or more"]);
    refused(TrainSettings { cap_max: 149, ..settings() }, &["cap_max", "149", "150"]);
    // Parts that other strategies do not support.
    let usual = TrainSettings::reference();
    for strategy in [StrategyType::Reference, StrategyType::Mcmc, StrategyType::Fixed] {
        refused(TrainSettings { recovery: true, strategy, ..usual.clone() }, &["recovery", "budget"]);
    }
    for strategy in [StrategyType::Reference, StrategyType::Mcmc] {
        let late = TrainSettings { late_min_opacity: 0.1, strategy, ..usual.clone() };
        refused(late, &["late_min_opacity", "budget"]);
    }
    let split = TrainSettings { split: SplitType::LongAxis, strategy: StrategyType::Mcmc, ..usual };
    refused(split, &["split", "long-axis"]);
}

/// Both parts in the reference's strategy change the result, are deterministic, and resume to the bit.
#[test]
fn the_reference_strategy_takes_other_statistics_and_splits() {
    let of = |absgrad, split| {
        let settings = TrainSettings { absgrad, split, ..crate::common::training::settings() };
        run(&settings)
    };
    let usual = of(false, SplitType::Sample).end(&[]);
    for (absgrad, split) in
        [(true, SplitType::Sample), (false, SplitType::LongAxis), (true, SplitType::LongAxis)]
    {
        let whole = of(absgrad, split).check_stops(&[&[22]]);
        assert!(whole.gaussians != usual.gaussians, "{absgrad} {split:?}");
    }
}
