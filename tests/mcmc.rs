//! Training with the 3DGS-MCMC strategy.

use crate::checkpoints::check_growth_in_bounded_memory;
use crate::common::prelude::*;

const CAP: u32 = 180;

/// Densifies after 15, 20, 25, 30 and 35.
fn settings() -> TrainSettings {
    TrainSettings {
        iterations: 40,
        sh_degree: 2,
        sh_degree_interval: 12,
        densify_from_iter: 10,
        densification_interval: 5,
        densify_until_iter: 38,
        cap_max: CAP,
        seed: 6,
        ..TrainSettings::of_strategy(StrategyType::Mcmc)
    }
}

/// A third of the Gaussians is dead.
fn with_dead() -> Gaussians {
    let mut gaussians = start();
    gaussians.opacity_logits.iter_mut().step_by(3).for_each(|logit| *logit = -9.0);
    gaussians
}

fn dead(gaussians: &Gaussians) -> usize {
    gaussians.opacity_logits.iter().filter(|&&logit| logit < -5.5).count()
}

fn run(views: Vec<TrainView>, settings: TrainSettings) -> Run<'static> {
    Run::shared(views, settings).starting_at(&with_dead())
}

#[test]
fn mcmc_moves_what_is_not_seen_and_grows_to_its_cap() {
    let mut trainer = run(views(3, 9), settings()).begin();
    let mut counts = vec![];
    for iteration in 1..=40 {
        let report = trainer.step().expect("a step");
        assert!(report.loss.is_finite() && report.skipped_non_finite == 0, "{iteration}");
        if let Some(densified) = report.densified {
            assert_eq!((densified.kept, densified.split), (densified.before, 0));
            assert_eq!(densified.rows(), report.gaussians);
            assert!(!densified.limited);
            counts.push(report.gaussians);
        }
        match iteration {
            15 => assert!(dead(&trainer.trained()) > 30),
            16 => assert_eq!(dead(&trainer.trained()), 0),
            _ => {}
        }
    }
    // 5 % each time, rounded down.
    assert_eq!(counts, [157, 164, 172, 180, 180]);
}

/// The noise moves means even if nothing else does.
#[test]
fn mcmc_explores_with_noise() {
    let moved = |noise_lr: f64| {
        let settings = TrainSettings { noise_lr, ..settings() };
        run(views(1, 9), settings).until(1, &[]).gaussians.means
    };
    let (still, first, again) = (moved(0.0), moved(5e5), moved(5e5));
    assert_eq!(first, again);
    let differ = still.iter().zip(&first).filter(|(a, b)| a != b).count();
    // All dead Gaussians.
    assert!(differ >= with_dead().len() / 3, "{differ}");
}

#[test]
fn mcmc_resumes_to_the_bit() {
    let whole = run(views(3, 9), settings()).check_stops(&[&[7, 15], &[16, 20], &[34, 35]]);
    assert_eq!(whole.gaussians.len() as u32, CAP);
}

#[test]
fn mcmc_grows_as_far_as_the_memory_allows() {
    let settings =
        TrainSettings { cap_max: 1_000_000, densification_interval: 1, iterations: 30, ..settings() };
    check_growth_in_bounded_memory(&settings);
}

#[test]
fn mcmc_refuses_a_cap_below_the_start() {
    let settings = TrainSettings { cap_max: 149, ..settings() };
    let refused = Run::shared(views(1, 9), settings).try_begin();
    assert_says(refusal(refused), &["cap_max", "149", "150"]);
}
