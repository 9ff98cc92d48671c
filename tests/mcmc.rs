//! Training with the 3DGS-MCMC strategy.

use ashsplat::trainer::{StrategyType, Trainer};
use ashsplat::{Gaussians, TrainSettings};

use crate::checkpoints::{check_growth_in_bounded_memory, end_of_run, start, views};
use crate::common::gpu::Gpu;

const EXTENT: f32 = 5.0;
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

#[test]
fn mcmc_moves_what_is_not_seen_and_grows_to_its_cap() {
    let gpu = Gpu::new();
    let mut trainer =
        Trainer::new(gpu.context, views(3, 9), &with_dead(), EXTENT, settings()).expect("a trainer");
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
            15 => assert!(dead(&trainer.gaussians().expect("Gaussians")) > 30),
            16 => assert_eq!(dead(&trainer.gaussians().expect("Gaussians")), 0),
            _ => {}
        }
    }
    // 5 % each time, rounded down.
    assert_eq!(counts, [157, 164, 172, 180, 180]);
}

/// The noise moves means even if nothing else does.
#[test]
fn mcmc_explores_with_noise() {
    let gpu = Gpu::new();
    let moved = |noise_lr: f64| {
        let settings = TrainSettings { noise_lr, ..settings() };
        let mut trainer =
            Trainer::new(gpu.context, views(1, 9), &with_dead(), EXTENT, settings).expect("a trainer");
        trainer.step().expect("a step");
        trainer.gaussians().expect("Gaussians").means
    };
    let (still, first, again) = (moved(0.0), moved(5e5), moved(5e5));
    assert_eq!(first, again);
    let differ = still.iter().zip(&first).filter(|(a, b)| a != b).count();
    // All dead Gaussians.
    assert!(differ >= with_dead().len() / 3, "{differ}");
}

#[test]
fn mcmc_resumes_to_the_bit() {
    let run = |stops: &[u32]| end_of_run(&with_dead(), &settings(), 40, stops);
    let whole = run(&[]);
    assert_eq!(whole.gaussians.len() as u32, CAP);
    for stops in [[7, 15], [16, 20], [34, 35]] {
        assert!(run(&stops) == whole, "interrupted after {stops:?}: other bits");
    }
}

/// With insufficient memory it grows as far as possible, continues, and is still deterministic.
#[test]
fn mcmc_grows_as_far_as_the_memory_allows() {
    let settings =
        TrainSettings { cap_max: 1_000_000, densification_interval: 1, iterations: 30, ..settings() };
    check_growth_in_bounded_memory(&settings);
}

#[test]
fn mcmc_refuses_a_cap_below_the_start() {
    let gpu = Gpu::new();
    let settings = TrainSettings { cap_max: 149, ..settings() };
    let refused = Trainer::new(gpu.context, views(1, 9), &start(), EXTENT, settings);
    let message = refused.err().expect("refused").to_string();
    assert!(message.contains("cap_max") && message.contains("149") && message.contains("150"), "{message}");
}
