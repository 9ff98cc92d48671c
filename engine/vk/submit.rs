//! Submits recordings and waits for them; uploads to and downloads from device memory.

use super::audit;
use super::commands::Commands;
use super::context::Context;
use super::lock::lock;
use super::memory::Buffer;
use super::memory_types::Location;
use super::profile::{self, MAX_SCOPES, Profiler, QUERIES, ScopeTime};
use super::recorder::{KeepAlive, MAX_UPDATE_BYTES, Recorder};
use crate::error::{Error, Result};
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
    profiler: Profiler,
    audit: Option<audit::Commands>,
    submitting: Instant,
    submitted: Instant,
    retained: KeepAlive,
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
        let mut profiler = std::mem::take(&mut self.profiler);
        let inner = &self.commands.inner;
        // The results are valid even if the times cannot be read.
        let collected = profiler.collect(inner).unwrap_or_default();
        let nanoseconds = collected.nanoseconds.unwrap_or_default();
        let report = RunReport { scopes: collected.scopes.clone(), nanoseconds };
        let label = profiler.label();
        if let Some(commands) = profiler.commands {
            commands.log(label, [self.submitting, self.submitted, done], collected);
        }
        Ok(report)
    }
}

impl Drop for Pending {
    fn drop(&mut self) {
        self.commands.settle();
        for block in &self.retained.blocks {
            block.in_flight.fetch_sub(1, Ordering::Release);
        }
    }
}

impl Context {
    pub(crate) fn check_alive(&self) -> Result<()> {
        if self.is_lost() { Err(Error::DeviceLost { call: "an earlier call" }) } else { Ok(()) }
    }

    /// Starts a recording under a label. Dropping the recorder discards it.
    pub fn begin(&self, label: &'static str) -> Result<Recorder> {
        self.check_alive()?;
        let profile = lock(&self.logs.profile).upgrade();
        let profiled = profile.map(|log| profile::Commands::begin(&self.device, log)).transpose()?;
        let audit = lock(&self.logs.audit).upgrade();
        let queries = if profiled.is_some() { QUERIES } else { 2 * MAX_SCOPES };
        let commands = Commands::begin(&self.pools, None, label, queries)?;
        let audited = audit.map(|log| audit::Commands::begin(log, label));
        Ok(Recorder::new(commands, label, profiled, audited))
    }

    /// Submits a recording. Wait for the [`Pending`] before using its results.
    ///
    /// # Panics
    /// When the recorder records into a foreign command buffer.
    pub fn submit(&self, mut recorder: Recorder) -> Result<Pending> {
        let submitting = Instant::now();
        recorder.check()?;
        let (commands, profiler, retained, audit) = recorder.finish();
        let mut pending = Pending { commands, profiler, audit, submitting, submitted: submitting, retained };
        for block in &pending.retained.blocks {
            block.in_flight.fetch_add(1, Ordering::Release);
        }
        pending.commands.submit(None)?;
        pending.submitted = Instant::now();
        Ok(pending)
    }

    /// Records, submits and waits.
    pub fn run(&self, label: &'static str, record: impl FnOnce(&mut Recorder)) -> Result<RunReport> {
        let mut recorder = self.begin(label)?;
        record(&mut recorder);
        self.submit(recorder)?.wait()
    }
}

const CHUNK_BYTES: u64 = 16 << 20;
/// Chunk size when reading mapped memory: chunks stay in the cache.
const MAPPED_CHUNK_BYTES: u64 = 256 << 10;

impl Context {
    /// Copies bytes to the start of a buffer and waits. Writes directly if the memory is mapped, otherwise copies from a
    /// ring of staging memory that the context keeps ([`Context::free_staging`]).
    ///
    /// # Errors
    /// [`crate::Error::Argument`] when the bytes do not fit, or while a submission that uses the buffer's
    /// arena is running.
    pub fn upload(&self, buffer: &Buffer, bytes: &[u8]) -> Result<()> {
        buffer.check_range(0, bytes.len())?;
        if bytes.is_empty() {
            return Ok(());
        }
        if buffer.block().is_mapped() {
            buffer.check_idle()?;
            buffer.block().write_mapped(buffer.offset(), bytes);
            return Ok(());
        }
        let whole_words = bytes.len().is_multiple_of(4) && buffer.offset().is_multiple_of(4);
        if bytes.len() <= MAX_UPDATE_BYTES && whole_words {
            return self.run("upload", |recorder| recorder.update(buffer, bytes)).map(drop);
        }
        let copied = self.copy_staged(buffer, bytes, true).and_then(|()| self.finish_uploads());
        if self.is_foreign() {
            // A host gets its memory back.
            self.free_staging();
        }
        copied
    }

    /// Same as [`Context::upload`], but without waiting: the bytes are copied to staging memory. Submissions after
    /// [`Context::take_over_uploads`] see them in the buffer. Until then the caller must not write these bytes otherwise,
    /// and nothing in flight may use them: a copy queue may write them at once.
    ///
    /// With `beside`, the upload uses the copy queue even if the host sees a card's memory (resizable BAR): writing that memory would have
    /// to wait for the main queue's work. All uploads to a buffer are then `beside`: the host writes only memory that no copy is
    /// known to use.
    pub(crate) fn begin_upload(&self, buffer: &Buffer, bytes: &[u8], beside: bool) -> Result<()> {
        let copies = beside && self.device.location == Location::Window && self.device.copying.is_some();
        if !copies && (buffer.block().is_mapped() || self.is_foreign()) {
            return self.upload(buffer, bytes);
        }
        buffer.check_range(0, bytes.len())?;
        self.copy_staged(buffer, bytes, false)
    }

    /// Makes all later submissions see the uploaded data.
    pub(crate) fn take_over_uploads(&self) -> Result<()> {
        lock(&self.staging).take_over(&self.pools)
    }

    pub(super) fn is_audited(&self) -> bool {
        lock(&self.logs.audit).strong_count() > 0
    }

    /// Waits for all uploads in flight.
    pub(crate) fn finish_uploads(&self) -> Result<()> {
        self.take_over_uploads()?;
        lock(&self.staging).settle(&self.device)
    }

    fn copy_staged(&self, buffer: &Buffer, bytes: &[u8], after_work: bool) -> Result<()> {
        self.check_alive()?;
        let mut ring = lock(&self.staging);
        let mut done = 0;
        while done < bytes.len() {
            let rest = buffer.range(done as u64, buffer.bytes() - done as u64);
            let copied = ring.copy(&self.pools, &rest, &bytes[done..], after_work);
            done += copied.inspect_err(|_| ring.forget(buffer))?;
        }
        Ok(())
    }

    /// Returns the bytes of a buffer, after all earlier submissions.
    ///
    /// # Errors
    /// [`crate::Error::Argument`] while a submission that uses the buffer's arena is running.
    pub fn download(&self, buffer: &Buffer) -> Result<Vec<u8>> {
        let mut bytes = Vec::with_capacity(buffer.bytes() as usize);
        self.download_chunks(buffer, |chunk| bytes.extend_from_slice(chunk))?;
        Ok(bytes)
    }

    /// Passes the contents of a buffer to `take` in order, chunk by chunk, so that they are not held twice. All chunks
    /// except the last have a multiple of 256 bytes.
    pub fn download_chunks(&self, buffer: &Buffer, mut take: impl FnMut(&[u8])) -> Result<()> {
        let (block, total) = (buffer.block(), buffer.bytes());
        if block.is_read_mapped() && total > 0 {
            buffer.check_idle()?;
            let mut chunk = vec![0; total.min(MAPPED_CHUNK_BYTES) as usize];
            for offset in (0..total).step_by(MAPPED_CHUNK_BYTES as usize) {
                let bytes = &mut chunk[..(total - offset).min(MAPPED_CHUNK_BYTES) as usize];
                block.read_mapped(buffer.offset() + offset, bytes);
                take(bytes);
            }
            return Ok(());
        }
        let mut chunk = vec![0; total.min(CHUNK_BYTES) as usize];
        let (mut offset, mut downloaded) = (0, Ok(0));
        while offset < total && downloaded.is_ok() {
            let part = buffer.range(offset, (total - offset).min(CHUNK_BYTES));
            downloaded = self.download_staged(&part, &mut chunk);
            if let Ok(length) = downloaded {
                take(&chunk[..length]);
                offset += length as u64;
            }
        }
        if self.is_foreign() {
            self.free_staging();
        }
        downloaded.map(drop)
    }

    /// Reads as many bytes of a buffer as fit a piece of the ring, and returns their number.
    fn download_staged(&self, from: &Buffer, bytes: &mut [u8]) -> Result<usize> {
        let mut ring = lock(&self.staging);
        let (staging, place) = ring.reserve(&self.device, from.bytes())?;
        let length = place.end - place.start;
        let (from, to) = (from.range(0, length), staging.range(place.start, length));
        let ran = self.run("download", |recorder| recorder.copy(&from, &to));
        ran.inspect_err(|_| ring.abandon())?;
        to.block().read_mapped(to.offset(), &mut bytes[..length as usize]);
        Ok(length as usize)
    }

    /// Returns the most bytes of temporary memory for an upload of `bytes` bytes.
    pub(crate) fn staging_bytes(&self, bytes: u64) -> u64 {
        if self.device.reads_mapped() { 0 } else { bytes.min(CHUNK_BYTES) }
    }
}
