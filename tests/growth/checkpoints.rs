//! Checkpoints with many Gaussians and values of a strategy.

use super::{assert_linear, gaussians};
use crate::checkpoint::CheckpointFile;
use ashsplat::train::checkpoint::{Checkpoint, StrategyState};
use std::path::Path;

#[path = "../fuzz/src/checkpoint.rs"]
mod valid;

/// A checkpoint of `count` Gaussians with `own` values of the strategy.
fn checkpoint(count: usize, own: usize) -> Checkpoint {
    Checkpoint {
        strategy: StrategyState {
            name: "a strategy".into(),
            terms: (0..own).map(|index| format!("term {index}")).collect(),
            values: (0..own).map(|index| (format!("value {index:06}"), "1".into())).collect(),
        },
        ..valid::checkpoint(gaussians(count, 1), 1)
    }
}

#[test]
fn checkpoints_of_many_gaussians_or_values() {
    for (size, shape) in [(20_000, (|size| [size, 2]) as fn(usize) -> [usize; 2]), (1000, |size| [1, size])] {
        let write = |folder: &Path, size: usize| {
            let [count, own] = shape(size);
            checkpoint(count, own).write(folder.join("a.safetensors")).unwrap();
        };
        assert_linear(size, write, |folder| {
            let read = Checkpoint::read(folder.join("a.safetensors")).unwrap();
            assert!(read.gaussians.len().max(read.strategy.values.len()) >= size);
        });
    }
}
