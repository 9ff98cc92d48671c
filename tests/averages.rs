//! Parameters that are averaged over the last steps of a run.

use ashsplat::trainer::{Checkpoint, OptimizerType, StrategyType, Trainer};
use ashsplat::{Gaussians, TrainSettings};
use ashsplat_files::CheckpointFile;
use tempfile::tempdir;

use crate::checkpoints::{check_resumed_with, settings as usual, start, views};
use crate::common::compare::elementwise;
use crate::common::gpu::Gpu;
use crate::reference::average::mean;

const EXTENT: f32 = 5.0;

/// The last densification is after iteration 30 of 40.
fn settings(average_last: f64) -> TrainSettings {
    TrainSettings { average_last, exposure: true, lens_effects: true, ..usual() }
}

fn trainer(settings: &TrainSettings) -> Trainer {
    Trainer::new(Gpu::new().context, views(3, 9), &start(), EXTENT, settings.clone()).expect("a trainer")
}

/// All averaged values.
fn values(trainer: &Trainer) -> Vec<f64> {
    let Gaussians { means, quats, log_scales, opacity_logits, sh, .. } =
        trainer.gaussians().expect("Gaussians");
    let exposures = trainer.exposures().expect("exposures").into_iter().flat_map(|e| e.rows);
    let lenses = trainer.lens_effects().expect("lens effects").into_iter().flat_map(|e| e.rows);
    let flat = [means.as_flattened(), quats.as_flattened(), log_scales.as_flattened(), &opacity_logits];
    let light: Vec<f32> = exposures.chain(lenses).flatten().collect();
    let sh = sh.as_flattened();
    flat.into_iter().flatten().chain(sh).chain(&light).map(|&x| f64::from(x)).collect()
}

/// The parameters after each step from `first` on, and at the end.
fn along(settings: &TrainSettings, first: u32) -> (Vec<Vec<f64>>, Vec<f64>) {
    let mut trainer = trainer(settings);
    let mut steps = Vec::new();
    for iteration in 1..settings.iterations {
        trainer.step().expect("a step");
        if iteration >= first {
            steps.push(values(&trainer));
        }
    }
    trainer.step().expect("the last step");
    (steps, values(&trainer))
}

#[test]
fn averages_are_means_of_the_last_steps() {
    let (steps, last) = along(&settings(0.0), 31);
    assert_eq!(steps[8], last, "the last iteration moves nothing");
    // Shares of nine steps and of all steps: the mean starts after the last densification.
    for share in [0.225, 1.0] {
        let (same, end) = along(&settings(share), 31);
        assert!(same == steps, "{share}: training itself is another");
        let mut expected = last.clone();
        for (number, values) in (1..).zip(&steps) {
            expected
                .iter_mut()
                .zip(values)
                .for_each(|(mean_of, &value)| *mean_of = mean(*mean_of, value, number));
        }
        elementwise("means", &end, &expected, 2e-5, 1e-5).unwrap_or_else(|e| panic!("{share}: {e}"));
        let moved =
            expected.iter().zip(&last).filter(|(mean_of, last)| (*mean_of - *last).abs() > 1e-4).count();
        assert!(moved > 1000, "{moved}");
    }
}

#[test]
fn averages_go_on_from_checkpoints_to_the_bit() {
    let settings = settings(0.25);
    let sparse =
        TrainSettings { optimizer_type: OptimizerType::SparseAdam, exposure: false, ..settings.clone() };
    let filtered = TrainSettings { filter_3d: true, ..settings.clone() };
    for settings in [&settings, &sparse, &filtered] {
        check_resumed_with(|| views(3, 9), settings, &[29, 31, 36, 39]);
    }
    // Through a file, and on into a longer run, which starts from the mean.
    let mut trainer = trainer(&settings);
    (0..36).for_each(|_| drop(trainer.step().expect("a step")));
    let checkpoint = trainer.checkpoint().expect("a checkpoint");
    let means = checkpoint.means.as_ref().expect("means");
    assert_eq!((means.steps, means.gaussians.len()), (6, checkpoint.gaussians.len()));
    assert_eq!((means.light.exposures.len(), means.light.lenses.len()), (3, checkpoint.lenses.values.len()));
    let folder = tempdir().expect("a folder");
    let path = folder.path().join("checkpoint");
    checkpoint.write(&path).expect("written");
    assert!(Checkpoint::read(&path).expect("read") == checkpoint);
    (36..40).for_each(|_| drop(trainer.step().expect("a step")));
    let end = trainer.checkpoint().expect("the end");
    assert_eq!(end.means, None);
    let longer = TrainSettings { iterations: 44, ..settings };
    let resumed = Trainer::resume(Gpu::new().context, views(3, 9), EXTENT, longer, &end);
    let mut resumed = resumed.expect("resumed");
    (40..44).for_each(|_| drop(resumed.step().expect("a step")));
    // A checkpoint whose means belong to other Gaussians.
    let mut broken = checkpoint;
    broken.means.as_mut().expect("means").gaussians = start();
    assert!(broken.check().expect_err("refused").to_string().contains("means"));
}

#[test]
fn averages_need_a_step_after_each_view() {
    let of = |multi_step| TrainSettings {
        average_last: 0.1,
        multi_step,
        cap_max: 0,
        ..TrainSettings::of_strategy(StrategyType::Budget)
    };
    let made = |settings| Trainer::new(Gpu::new().context, views(3, 9), &start(), EXTENT, settings).map(drop);
    let message = made(of(true)).expect_err("refused").to_string();
    assert!(message.contains("average_last") && message.contains("multi_step"), "{message}");
    made(of(false)).expect("made");
}
