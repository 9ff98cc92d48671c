//! Prunings between two steps without memory for their decisions.

use ashsplat::TrainSettings;
use ashsplat::trainer::{StrategyType, Trainer};
use ashsplat::vk::Fault;

use super::{assert_nothing_allocated, chosen, close, device};
use crate::checkpoints::{start, views};

const EXTENT: f32 = 5.0;

/// Each allocation of a pruning of a share fails: the pruning is skipped, and training continues.
#[test]
fn faults_of_prunings() {
    let (context, faults) = device();
    let settings = TrainSettings {
        iterations: 1000,
        sh_degree: 1,
        scale_schedule: false,
        densify_from_iter: 900,
        densify_until_iter: 990,
        opacity_reset_interval: 130,
        cap_max: 1000,
        ..TrainSettings::of_strategy(StrategyType::Budget)
    };
    let mut trainer =
        Trainer::new(&context, views(2, 5), &start(), EXTENT, settings.clone()).expect("a trainer");
    (0..430).for_each(|_| drop(trainer.step().expect("a step")));
    // The pruning is due next.
    let before = trainer.checkpoint().expect("a checkpoint");
    drop(trainer);
    let resumed =
        || Trainer::resume(&context, views(2, 5), EXTENT, settings.clone(), &before).expect("resumed");
    let mut trainer = resumed();
    faults.disarm();
    let pruned = trainer.step().expect("a step").densified.expect("due");
    assert!(pruned.kept < pruned.before && !pruned.limited, "{pruned:?}");
    let calls = chosen(Fault::Allocation, &faults, 1);
    drop(trainer);
    let mut left_out = 0;
    for (index, many) in calls.into_iter().flat_map(|index| [(index, 1), (index, 3)]) {
        let mut trainer = resumed();
        faults.arm_many(Fault::Allocation, index, many);
        let step = trainer.step();
        faults.disarm();
        // The step itself allocates as well.
        if let Ok(report) = step {
            let densified = report.densified.expect("due");
            assert!(densified == pruned || densified.limited, "{densified:?}");
            assert!(!densified.limited || densified.rows() == densified.before, "{densified:?}");
            left_out += u32::from(densified.limited);
        }
        trainer.step().expect("it goes on");
        drop(trainer);
        assert_nothing_allocated(&context, "prunings");
    }
    // One allocation for the order of opacities, one for the decisions.
    assert!(left_out >= 2, "{left_out}");
    close(context);
}
