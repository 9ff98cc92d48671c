//! What reading costs: four times the input, at most five times the steps and five times the bytes reserved. Hostile
//! input is among it. These are the crate's own tests because they count its steps and all that it reserves.

// In a test, an unwrap is an assertion.
#![allow(clippy::unwrap_used)]

mod cameras;
mod checkpoints;
mod colmap;
mod lists;
mod memory;
mod names;
mod photos;
mod scenes;

use std::alloc::System;
use std::path::Path;
use std::sync::atomic::Ordering;
use std::sync::{Mutex, MutexGuard, PoisonError};

use cap::Cap;

use crate::cost::counter::STEPS;
use crate::dataset::{Dataset, DatasetOptions, DatasetReport};
use crate::progress::Progress;

#[global_allocator]
static MEMORY: Cap<System> = Cap::new(System, usize::MAX);

/// One test at a time: the counts are those of the process. Every test of this crate takes it, also one that counts
/// nothing: what it reads would be counted for another.
pub(crate) fn turn() -> MutexGuard<'static, ()> {
    static TURN: Mutex<()> = Mutex::new(());
    TURN.lock().unwrap_or_else(PoisonError::into_inner)
}

/// What something costs.
#[derive(Clone, Copy, Debug)]
struct Cost {
    steps: u64,
    bytes: u64,
}

impl Cost {
    /// What `work` costs, the second time: what is made once is not counted.
    fn of<T>(work: impl Fn() -> T) -> (Self, T) {
        work();
        let before = (STEPS.load(Ordering::Relaxed), MEMORY.total_allocated() as u64);
        let result = work();
        let after = (STEPS.load(Ordering::Relaxed), MEMORY.total_allocated() as u64);
        (Self { steps: after.0 - before.0, bytes: after.1 - before.1 }, result)
    }
}

/// Writes input of a size into a folder, reads it, writes four times as much, and compares what both cost.
fn assert_linear(size: usize, write: impl Fn(&Path, usize), read: impl Fn(&Path)) {
    let _turn = turn();
    let [small, large] = [size, 4 * size].map(|size| {
        let folder = tempfile::tempdir().unwrap();
        write(folder.path(), size);
        Cost::of(|| read(folder.path())).0
    });
    assert!(large.steps <= 5 * small.steps, "{small:?} {large:?}");
    assert!(large.bytes <= 5 * small.bytes, "{small:?} {large:?}");
    assert!(small.steps > 0, "nothing was counted");
}

fn inspect(folder: &Path) -> DatasetReport {
    Dataset::inspect(folder, &DatasetOptions::default(), Progress::NONE)
}

/// Runs something with little room for recursion.
fn on_a_small_stack(work: impl FnOnce() + Send + 'static) {
    let _turn = turn();
    std::thread::Builder::new().stack_size(256 << 10).spawn(work).unwrap().join().unwrap();
}
