//! Progress reports and cancellation of long operations.

use std::sync::atomic::{AtomicBool, Ordering};

use ashsplat::{Error, Result};

/// Observer of a long operation: receives the progress and may request a stop.
#[derive(Clone, Copy, Default)]
pub struct Progress<'a> {
    /// Called with (done, total) after each step, from any thread.
    pub report: Option<&'a (dyn Fn(usize, usize) + Sync)>,
    /// When this becomes true, the operation ends soon with [`Error::Interrupted`].
    pub interrupted: Option<&'a AtomicBool>,
}

impl Progress<'_> {
    /// No observer.
    pub const NONE: Progress<'static> = Progress { report: None, interrupted: None };

    pub(crate) fn step(&self, done: usize, total: usize) {
        if let Some(report) = self.report {
            report(done, total);
        }
    }

    pub(crate) fn check(&self) -> Result<()> {
        match self.interrupted {
            Some(flag) if flag.load(Ordering::Relaxed) => Err(Error::Interrupted),
            _ => Ok(()),
        }
    }
}

impl std::fmt::Debug for Progress<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Progress").field("report", &self.report.is_some()).finish_non_exhaustive()
    }
}
