//! Submits recordings and waits for them.

use super::audit;
use super::commands::Commands;
use super::context::Context;
use super::profile::Profiler;
use super::profile::{self, HostTimes, ScopeTime};
use super::recorder::Recorder;
use super::resources::Kept;
use crate::{Error, Result};
use std::sync::PoisonError;
use std::sync::atomic::Ordering;
use std::time::Instant;

/// Device times of a submission.
#[derive(Clone, Debug, Default)]
#[non_exhaustive]
pub struct RunReport {
    /// Time of each [`Recorder::scope`] in recording order. Empty without timestamps.
    pub scopes: Vec<ScopeTime>,
    /// Time of the whole recording on the device, nanoseconds. 0 without timestamps.
    pub nanoseconds: f64,
}

/// A running submission. Dropping it also waits.
#[must_use = "the results are there only after wait()"]
pub struct Pending {
    // Drop order matters: the wait must come before the memory is freed.
    commands: Commands,
    profiler: Option<Profiler>,
    audit: Option<audit::Commands>,
    label: String,
    submitting: Instant,
    submitted: Instant,
    kept: Kept,
}

impl Pending {
    /// Waits until the device has finished; then its results may be read.
    ///
    /// # Errors
    /// [`Error::DeviceLost`]. [`Error::Timeout`] after [`super::ContextOptions::timeout`]: a thread then waits for the
    /// submission, and its resources remain in use until it has finished.
    pub fn wait(mut self) -> Result<RunReport> {
        let timeout = self.commands.inner.timeout;
        if let Err(error) = self.commands.wait(timeout) {
            if self.commands.submitted {
                // If no thread can be spawned, the closure is dropped, which waits here.
                let _ = std::thread::Builder::new().name("late submission".into()).spawn(move || drop(self));
            }
            return Err(error);
        }
        let done = Instant::now();
        if let Some(mut audit) = self.audit.take() {
            audit.log()?;
        }
        let Some(mut profiler) = self.profiler.take() else { return Ok(RunReport::default()) };
        let inner = &self.commands.inner;
        // The results are valid even if the times cannot be read.
        let collected = profiler.collect(inner).unwrap_or_default();
        let report = RunReport {
            scopes: collected.scopes.clone(),
            nanoseconds: collected.nanoseconds.unwrap_or_default(),
        };
        if let Some(commands) = profiler.commands {
            let host = HostTimes { submitting: self.submitting, submitted: self.submitted, done };
            commands.log(inner, std::mem::take(&mut self.label), host, collected);
        }
        Ok(report)
    }
}

impl Drop for Pending {
    fn drop(&mut self) {
        self.commands.settle();
        for block in &self.kept.blocks {
            block.in_flight.fetch_sub(1, Ordering::Release);
        }
    }
}

impl Context {
    /// Fails if the device is lost.
    pub(crate) fn check_alive(&self) -> Result<()> {
        if self.is_lost() { Err(Error::DeviceLost { call: "an earlier call" }) } else { Ok(()) }
    }

    /// Starts a recording under a label. Dropping the recorder discards it.
    ///
    /// # Errors
    /// [`Error::Vulkan`] when the driver has no memory left, [`Error::DeviceLost`].
    pub fn begin(&self, label: &str) -> Result<Recorder> {
        self.check_alive()?;
        let profile = self.logs.profile.lock().unwrap_or_else(PoisonError::into_inner).upgrade();
        let profiled = profile.map(|log| profile::Commands::begin(&self.device, log)).transpose()?;
        let audit = self.logs.audit.lock().unwrap_or_else(PoisonError::into_inner).upgrade();
        let commands = Commands::begin(&self.pools, label, profiled.is_some())?;
        let audited = audit.map(|log| audit::Commands::begin(log, label));
        Ok(Recorder::new(commands, label, profiled, audited))
    }

    /// Submits a recording. Wait for the [`Pending`] before using its results.
    ///
    /// # Errors
    /// [`Error::DeviceLost`]. [`Error::Vulkan`] when out of memory, even if that happened while recording.
    ///
    /// # Panics
    /// When the recorder records into a foreign command buffer.
    pub fn submit(&self, mut recorder: Recorder) -> Result<Pending> {
        let submitting = Instant::now();
        recorder.check()?;
        let (commands, profiler, kept, audit) = recorder.finish();
        let label = profiler.label();
        let mut pending = Pending {
            commands,
            profiler: Some(profiler),
            audit,
            label,
            submitting,
            submitted: submitting,
            kept,
        };
        for block in &pending.kept.blocks {
            block.in_flight.fetch_add(1, Ordering::Release);
        }
        pending.commands.submit()?;
        pending.submitted = Instant::now();
        Ok(pending)
    }

    /// Records, submits and waits.
    ///
    /// # Errors
    /// Errors of `record` (nothing is submitted then), of [`Context::submit`] and of [`Pending::wait`].
    pub fn run(&self, label: &str, record: impl FnOnce(&mut Recorder) -> Result<()>) -> Result<RunReport> {
        let mut recorder = self.begin(label)?;
        record(&mut recorder)?;
        self.submit(recorder)?.wait()
    }
}
