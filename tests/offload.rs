//! Training with parameters and moments in host memory: the same bits, and little device memory.

use crate::common::prelude::*;
use ashsplat::train::OptimizerType;

/// Bytes of a Gaussian of SH degree 3 in each of the three sets.
const SET: u64 = 4 * (3 * 4 + 48);
const HOST: Option<u64> = Some(1 << 30);

/// Many small Gaussians: most of their memory is parameters and moments.
fn start(count: usize) -> Gaussians {
    let mut random = Random::new(77);
    gaussians(&(0..count).map(|_| gaussian(&mut random, 1.5, [-5.0, -4.0], 16)).collect::<Vec<_>>())
}

/// Densifies twice and resets opacities once.
fn settings() -> TrainSettings {
    TrainSettings {
        iterations: 24,
        sh_degree_interval: 4,
        densify_from_iter: 4,
        densification_interval: 7,
        densify_until_iter: 22,
        opacity_reset_interval: 16,
        densify_grad_threshold: 1e-6,
        ..TrainSettings::reference()
    }
}

fn run<'a>(context: &'a Context, start: &Gaussians, settings: &TrainSettings) -> Run<'a> {
    Run::new(context, views(3, 9), settings.clone()).starting_at(start)
}

/// Trains to the end. Returns the last checkpoint, then bytes: of the device, their peak, and the host's peak.
fn train(
    start: &Gaussians,
    settings: &TrainSettings,
    (max_memory, offload): (Option<u64>, Option<u64>),
) -> Result<(Checkpoint, [u64; 3])> {
    let context = bounded(max_memory);
    context.set_offload(offload);
    let mut trainer = run(&context, start, settings).try_begin()?;
    trainer.finish();
    let end = trainer.state();
    let at_end = context.memory_total().bytes;
    drop(trainer);
    assert_silent(&context);
    assert_eq!(context.memory_offloaded().bytes, 0, "left behind");
    Ok((end, [at_end, context.memory_total().peak_bytes, context.memory_offloaded().peak_bytes]))
}

/// A scene of four times the device memory trains with the same bits as with enough memory.
#[test]
fn offload_trains_four_times_what_the_device_holds() {
    let start = start(20_000);
    let (whole, [all, _, none]) = train(&start, &settings(), (None, None)).expect("trained");
    assert_eq!(none, 0);
    let budget = Some(all / 4);
    let (stunted, _) = train(&start, &settings(), (budget, None)).expect("trained");
    let (end, [_, device, host]) = train(&start, &settings(), (budget, HOST)).expect("trained");
    assert!(Some(device) <= budget, "{device} bytes of {budget:?}");
    let rows = whole.gaussians.len() as u64;
    let held = stunted.gaussians.len() as u64;
    assert!(2 * held < rows, "{held} Gaussians of {rows} are as many as the device holds");
    assert!(host >= rows * 3 * SET, "{host} bytes of {rows} Gaussians");
    assert!(end.fingerprint() == whole.fingerprint(), "other bits within {budget:?} bytes");
}

/// Every strategy gives the same bits, also if a run resumes with other memory.
#[test]
fn offload_changes_no_bit_of_any_strategy() {
    let start = start(2000);
    let of = |strategy| TrainSettings { strategy, absgrad: false, ..settings() };
    let budget = TrainSettings { scale_schedule: false, ..of(StrategyType::Budget) };
    let filtered = TrainSettings { filter_3d: true, opacity_reg: 0.01, ..settings() };
    let sparse = TrainSettings { optimizer_type: OptimizerType::SparseAdam, pose_opt: true, ..settings() };
    for settings in [budget, of(StrategyType::Mcmc), filtered, sparse] {
        let (whole, _) = train(&start, &settings, (None, None)).expect("trained");
        let context = bounded(None);
        let run = run(&context, &start, &settings);
        let mut trainer = run.begin();
        for (offload, until) in [(HOST, 9), (None, 17), (HOST, settings.iterations)] {
            context.set_offload(offload);
            let checkpoint = trainer.state();
            drop(trainer);
            trainer = run.resume(&checkpoint);
            trainer.steps(until - checkpoint.iteration);
            assert_eq!(context.memory_offloaded().bytes > 0, offload.is_some());
        }
        assert!(trainer.state() == whole, "other bits with {:?}", settings.strategy);
    }
}

/// Sets beyond the host memory are refused before any allocation; growth stops at the bound.
#[test]
fn offload_is_bounded() {
    let start = start(6000);
    let settings = TrainSettings { densify_grad_threshold: 0.0, ..settings() };
    let planes = 6144 * 3 * SET;
    let error = train(&start, &settings, (None, Some(planes - 1))).expect_err("too little");
    let Error::TooLarge { needed, limit, limit_name, .. } = error else { panic!("{error}") };
    assert_eq!((needed, limit, limit_name), (planes, planes - 1, "--offload"));
    // Enough for one set with half as many Gaussians more, but not for the sets before and after growth.
    let bound = planes * 9 / 4;
    let (end, [.., host]) = train(&start, &settings, (None, Some(bound))).expect("trained");
    let (free, _) = train(&start, &settings, (None, HOST)).expect("trained");
    let (bounded, free) = (end.gaussians.len(), free.gaussians.len());
    let is_bounded = host <= bound && (6000..=9216).contains(&bounded) && bounded < free;
    assert!(is_bounded, "{bounded} of {free}, {host} bytes");
}
