//! The views whose PSNR is tracked.

use super::*;
use ashsplat::{StepReport, TrainSettings};

fn views(count: u32) -> Vec<View> {
    let view = dataset(1.0).train.remove(0);
    (0..count).map(|i| View { name: format!("{i:03}.png"), ..view.clone() }).collect()
}

fn step(iteration: u32, milliseconds: f64) -> StepReport {
    StepReport { iteration, milliseconds, ..StepReport::default() }
}

fn of(iterations: u32) -> TrainSettings {
    TrainSettings { iterations, ..TrainSettings::reference() }
}

#[test]
fn measuring_keeps_to_its_share_of_time() {
    for (share, cost) in [(0.02, 0.5), (0.2, 0.5), (0.02, 0.0001)] {
        let mut tracking = Tracking::new(&views(9), &of(1000), share);
        let (mut measured, mut spent) = (0, 0.0);
        for iteration in 1..=1000 {
            if tracking.is_due(&step(iteration, 50.0)) {
                // The first measurement builds kernels.
                let cost = if measured == 0 { 100.0 } else { cost };
                tracking.measured(iteration, std::time::Duration::from_secs_f64(cost));
                spent += if measured == 0 { 0.0 } else { cost };
                measured += 1;
            }
        }
        // The last measurement is paid off later.
        assert!(spent - cost <= share * (50.0 + spent), "{spent} s of 50 at {share}");
        assert!((2..=200).contains(&measured), "{measured}");
        assert!(spent > 0.8 * share * 50.0 || measured == 200, "{spent} s at {share}");
    }
    let mut none = Tracking::new(&views(9), &of(1000), 0.0);
    assert!((1..=1000).all(|iteration| !none.is_due(&step(iteration, 50.0))));
    let mut nothing = Tracking::new(&[], &of(1000), 0.02);
    assert!((1..=1000).all(|iteration| !nothing.is_due(&step(iteration, 50.0))));
    assert!(["0", "0.02"].iter().all(|text| tracking::share(text).is_ok()));
    assert!(["-1", "1", "0.0001", "NaN"].iter().all(|text| tracking::share(text).is_err()));
}

/// Right after many Gaussians were cloned or split, the PSNR says little about the training.
#[test]
fn nothing_is_measured_right_after_growth() {
    let mut tracking = Tracking::new(&views(2), &of(1000), 0.9);
    let gaussians = |iteration: u32| if iteration < 600 { 1000 } else { 1000 + 10 * (iteration / 100) };
    let mut measured = Vec::new();
    for iteration in 1..=1000 {
        if tracking.is_due(&StepReport { gaussians: gaussians(iteration), ..step(iteration, 50.0) }) {
            tracking.measured(iteration, std::time::Duration::from_millis(1));
            measured.push(iteration);
        }
    }
    let after_growth = |&iteration: &u32| iteration >= 600 && iteration % 100 < 50;
    assert!(!measured.iter().any(after_growth), "{measured:?}");
    assert!(measured.iter().any(|iteration| *iteration < 50));
    for growth in [600, 700, 800, 900] {
        assert!(measured.contains(&(growth + 50)), "{measured:?}");
    }
}
