//! Cost of reading: for four times the input, at most five times the steps and five times the bytes reserved, also
//! for hostile input. These tests are inside the crate to count its steps and allocations.

// In a test, an unwrap is an assertion.
#![allow(clippy::unwrap_used)]

mod checkpoints;
mod colmap;
mod lists;
mod memory;
mod names;
mod photos;
mod scenes;

use crate::cost::counter::STEPS;
use crate::dataset::{Dataset, DatasetOptions, DatasetReport};
use crate::progress::Progress;
use ashsplat::scene::Gaussians;
use cap::Cap;
use std::alloc::System;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::sync::{Mutex, MutexGuard, PoisonError};

#[global_allocator]
static MEMORY: Cap<System> = Cap::new(System, usize::MAX);

/// Lets one test run at a time, because the counts are global. Tests that count nothing must take it, too, because
/// their allocations would be counted.
pub(crate) fn turn() -> MutexGuard<'static, ()> {
    static TURN: Mutex<()> = Mutex::new(());
    TURN.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The turn, with a temporary folder and the path of a file in it.
fn alone(name: &str) -> (MutexGuard<'static, ()>, tempfile::TempDir, PathBuf) {
    let (turn, folder) = (turn(), tempfile::tempdir().unwrap());
    let path = folder.path().join(name);
    (turn, folder, path)
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

fn gaussians(count: usize, sh_degree: u32) -> Gaussians {
    let coefficients = (sh_degree as usize + 1).pow(2);
    Gaussians {
        sh_degree,
        means: (0..count as u32).map(|i| [i.wrapping_mul(2_654_435_761) as f32 * 1e-7, 0.0, 1.0]).collect(),
        quats: vec![[1.0, 0.0, 0.0, 0.0]; count],
        log_scales: vec![[-3.0; 3]; count],
        opacity_logits: vec![0.5; count],
        sh: vec![[0.1; 3]; coefficients * count],
    }
}

fn on_a_small_stack(work: impl FnOnce() + Send + 'static) {
    let _turn = turn();
    std::thread::Builder::new().stack_size(256 << 10).spawn(work).unwrap().join().unwrap();
}
