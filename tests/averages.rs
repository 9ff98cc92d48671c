//! Parameters that are averaged over the last steps of a run.

use crate::common::prelude::*;
use crate::common::training::settings as usual;
use crate::reference::average::mean;
use ashsplat::train::OptimizerType;

/// The last densification is after iteration 30 of 40.
fn settings(average_last: f64) -> TrainSettings {
    TrainSettings { average_last, exposure: true, lens_effects: true, ..usual() }
}

fn run(settings: &TrainSettings) -> Run<'static> {
    Run::shared(views(3, 9), settings.clone())
}

fn values(trainer: &Trainer) -> Vec<f64> {
    let Gaussians { means, quats, log_scales, opacity_logits, sh, .. } = trainer.trained();
    let exposures = trainer.exposures().expect("exposures").into_iter().flat_map(|e| e.rows);
    let lenses = trainer.lens_effects().expect("lens effects").into_iter().flat_map(|e| e.rows);
    let flat = [means.as_flattened(), quats.as_flattened(), log_scales.as_flattened(), &opacity_logits];
    let appearance: Vec<f32> = exposures.chain(lenses).flatten().collect();
    let sh = sh.as_flattened();
    flat.into_iter().flatten().chain(sh).chain(&appearance).map(|&x| f64::from(x)).collect()
}

/// The parameters after each step from `first` on, and at the end.
fn along(settings: &TrainSettings, first: u32) -> (Vec<Vec<f64>>, Vec<f64>) {
    let mut trainer = run(settings).begin();
    trainer.steps(first - 1);
    let step = |_| {
        trainer.steps(1);
        values(&trainer)
    };
    let steps = (first..settings.iterations).map(step).collect();
    trainer.finish();
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
            for (mean_of, &value) in expected.iter_mut().zip(values) {
                *mean_of = mean(*mean_of, value, number);
            }
        }
        elementwise("means", &end, &expected, 2e-5, 1e-5).unwrap_or_else(|e| panic!("{share}: {e}"));
        let moved = expected.iter().zip(&last).filter(|(mean, last)| (*mean - *last).abs() > 1e-4).count();
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
        run(settings).check_stops(&[&[], &[29], &[31], &[36], &[39]]);
    }
    // On into a longer run, which starts from the mean.
    let checkpoint = run(&settings).until(36, &[]);
    let means = checkpoint.means.as_ref().expect("means");
    assert_eq!((means.steps, means.gaussians.len()), (6, checkpoint.gaussians.len()));
    assert_eq!(
        (means.appearance.exposures.len(), means.appearance.lenses.len()),
        (3, checkpoint.lenses.values.len())
    );
    assert!(through_a_file(&checkpoint) == checkpoint);
    let end = run(&settings).end(&[]);
    assert_eq!(end.means, None);
    run(&TrainSettings { iterations: 44, ..settings }).resume(&end).finish();
    // A checkpoint whose means belong to other Gaussians.
    let mut broken = checkpoint;
    broken.means.as_mut().expect("means").gaussians = start();
    assert!(broken.check().expect_err("refused").to_string().contains("means"));
}
