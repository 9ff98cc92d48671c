//! Cost of reading: for four times the input, at most five times the steps and five times the bytes reserved, also
//! for hostile input. These tests are inside the crate to count its steps and allocations.

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

/// Lets one test run at a time, because the counts are global. Tests that count nothing must take it, too, because
/// their allocations would be counted.
pub(crate) fn turn() -> MutexGuard<'static, ()> {
    static TURN: Mutex<()> = Mutex::new(());
    TURN.lock().unwrap_or_else(PoisonError::into_inner)
}

#[derive(Clone, Copy, Debug)]
struct Cost {
    steps: u64,
    bytes: u64,
}

impl Cost {
    /// Cost of the second run of `work`: one-time allocations do not count.
    fn of<T>(work: impl Fn() -> T) -> (Self, T) {
        work();
        let before = (STEPS.load(Ordering::Relaxed), MEMORY.total_allocated() as u64);
        let result = work();
        let after = (STEPS.load(Ordering::Relaxed), MEMORY.total_allocated() as u64);
        (Self { steps: after.0 - before.0, bytes: after.1 - before.1 }, result)
    }
}

/// Reads an input of this size and one of four times the size, and compares the costs.
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

/// Runs work with a small stack.
fn on_a_small_stack(work: impl FnOnce() + Send + 'static) {
    let _turn = turn();
    std::thread::Builder::new().stack_size(256 << 10).spawn(work).unwrap().join().unwrap();
}
