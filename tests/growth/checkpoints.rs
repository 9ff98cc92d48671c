//! Checkpoints with many Gaussians, statistics and values of a strategy.

use std::path::Path;

use ashsplat::TrainSettings;
use ashsplat::scene::{Gaussians, WorldFrame};
use ashsplat::trainer::checkpoint::{Checkpoint, Room, StrategyState, StrategyStatistic};
use ashsplat::trainer::strategy::Actions;

use super::assert_linear;
use crate::checkpoint::CheckpointFile;

/// A checkpoint of `count` Gaussians with statistics, and `own` values of the strategy.
fn checkpoint(count: usize, own: usize) -> Checkpoint {
    let gaussians = Gaussians {
        sh_degree: 1,
        means: vec![[0.5; 3]; count],
        quats: vec![[1.0, 0.0, 0.0, 0.0]; count],
        log_scales: vec![[-3.0; 3]; count],
        opacity_logits: vec![0.5; count],
        sh: vec![[0.1; 3]; 4 * count],
    };
    let statistic = |index: usize| StrategyStatistic {
        name: format!("statistic {index}"),
        floats: 1,
        values: vec![0.25; count],
    };
    Checkpoint {
        version: "1".into(),
        device: "a device".into(),
        driver: "a driver".into(),
        kernels: "gpu, subgroups of 32".into(),
        settings: TrainSettings { sh_degree: 1, ..TrainSettings::default() },
        views: 3,
        views_fingerprint: 7,
        scene_extent: 2.0,
        frame: WorldFrame::default(),
        iteration: 10,
        optimizer_steps: 10,
        opacity_steps: 10,
        due: Actions::NONE,
        first_moments: gaussians.clone(),
        second_moments: Gaussians { log_scales: vec![[3.0; 3]; count], ..gaussians.clone() },
        gaussians,
        statistics: vec![[0.0; 2]; count],
        filters: Vec::new(),
        strategy: StrategyState {
            name: "a strategy".into(),
            terms: (0..own).map(|index| format!("term {index}")).collect(),
            statistics: (0..own).map(statistic).collect(),
            values: (0..own).map(|index| (format!("value {index:06}"), "1".into())).collect(),
        },
        gradient_sums: None,
        means: None,
        exposures: Default::default(),
        lenses: Default::default(),
        poses: None,
        block: None,
        skipped: 0,
        room: Room::default(),
    }
}

fn read(folder: &Path) -> Checkpoint {
    Checkpoint::read(folder.join("a.safetensors")).unwrap()
}

#[test]
fn checkpoints_of_many_gaussians() {
    let write = |folder: &Path, size: usize| checkpoint(size, 2).write(folder.join("a.safetensors")).unwrap();
    assert_linear(20_000, write, |folder| {
        assert!(read(folder).gaussians.len() >= 20_000);
    });
}

#[test]
fn checkpoints_of_many_statistics_and_values() {
    let write = |folder: &Path, size: usize| checkpoint(1, size).write(folder.join("a.safetensors")).unwrap();
    assert_linear(1000, write, |folder| {
        let strategy = read(folder).strategy;
        assert!(strategy.statistics.len() >= 1000 && strategy.values.len() == strategy.statistics.len());
    });
}
