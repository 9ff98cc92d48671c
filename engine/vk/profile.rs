//! Opt-in profile of a context: every command of every submission, with its resources and its time.

use super::access::Access;
use super::allocator::MemoryKind;
use super::buffer::Buffer;
use super::open_device::Device;
use crate::Result;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Most timed commands of one profiled recording.
pub(super) const MAX_COMMANDS: u32 = 1024;

/// Number of readings of both clocks per submission.
const CLOCK_READINGS: u32 = 3;

/// Records all submissions of its context, command by command, until it is dropped. It costs a timestamp per command;
/// without a profile there is no cost.
pub struct Profile {
    pub(super) log: Arc<Log>,
}

/// Device time of a scope's commands.
#[derive(Clone, Debug, PartialEq)]
pub struct ScopeTime {
    /// The name given to [`super::Recorder::scope`].
    pub name: String,
    /// Its nesting depth.
    pub depth: u32,
    /// Time from the end of the previous work to the end of the scope's own commands.
    pub nanoseconds: f64,
}

/// A submission that has finished.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct Submission {
    /// Label given to [`Context::begin`](super::Context::begin) or [`Context::run`](super::Context::run).
    pub label: String,
    /// Commands in recording order.
    pub commands: Vec<CommandRecord>,
    /// Scopes, same as in [`super::RunReport`].
    pub scopes: Vec<ScopeTime>,
    /// Time on the device; None without timestamps.
    pub nanoseconds: Option<f64>,
    /// Host time when the recording began.
    pub begun: Instant,
    /// Host time when recording ended and submitting began.
    pub submitting: Instant,
    /// Host time when the driver had accepted it.
    pub submitted: Instant,
    /// Host time when its end was known.
    pub done: Instant,
    /// Host time when the device began it; None without timestamps.
    pub device_begun: Option<Instant>,
    /// True if `device_begun` comes from calibrated timestamps. Otherwise the device is assumed to have finished at `done`,
    /// which is late by the time it takes to wake the host.
    pub calibrated: bool,
    /// Error bound of a calibrated `device_begun`: half of the time that reading both clocks took. Zero if it is not
    /// calibrated.
    pub calibration_error: Duration,
}

/// A command of a recording.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct CommandRecord {
    /// The kernel's name, or "fill", "copy" or "update".
    pub name: &'static str,
    /// Innermost scope around it; empty without a scope.
    pub scope: String,
    /// Grid of a dispatch. For an indirect dispatch: its arguments at the end of the recording.
    pub workgroups: Option<[u32; 3]>,
    /// Its buffers.
    pub buffers: Vec<BoundBuffer>,
    /// Number of barriers since the previous command. If there are any, the command waits for all commands before them.
    pub barriers: u32,
    /// Begin, nanoseconds from the recording's begin on the device; None without timestamps.
    pub begin_ns: Option<f64>,
    /// Time from the end of the previous command to its own end, including the barrier between them. None without
    /// timestamps.
    pub nanoseconds: Option<f64>,
}

/// A buffer bound to a command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BoundBuffer {
    /// Its name in the kernel.
    pub role: &'static str,
    /// The name of its allocation.
    pub name: &'static str,
    /// How the command may access it.
    pub access: Access,
    /// Bytes bound: the capacity, not the bytes accessed.
    pub bytes: u64,
}

impl CommandRecord {
    pub(super) fn new(
        name: &'static str,
        workgroups: Option<[u32; 3]>,
        buffers: impl Iterator<Item = BoundBuffer>,
    ) -> Self {
        Self {
            name,
            scope: String::new(),
            workgroups,
            buffers: buffers.collect(),
            barriers: 0,
            begin_ns: None,
            nanoseconds: None,
        }
    }
}

impl BoundBuffer {
    pub(super) fn new(role: &'static str, buffer: &Buffer, access: Access) -> Self {
        Self { role, name: buffer.static_name(), access, bytes: buffer.bytes() }
    }
}

/// Device times of a recording.
#[derive(Default)]
pub(super) struct Collected {
    /// Time of the whole recording; None without timestamps.
    pub(super) nanoseconds: Option<f64>,
    pub(super) scopes: Vec<ScopeTime>,
    pub(super) commands: Vec<CommandRecord>,
    /// Device clock at the recording's begin, ticks.
    pub(super) begin_ticks: u64,
}

/// Log of submissions, and memory for the arguments of indirect dispatches.
#[derive(Default)]
pub(super) struct Log {
    submissions: Mutex<Vec<Submission>>,
    spare: Mutex<Vec<Buffer>>,
}

/// Commands of a current recording.
pub(super) struct Commands {
    log: Arc<Log>,
    records: Vec<CommandRecord>,
    /// Index of the record and arguments of each indirect dispatch.
    indirect: Vec<(usize, Buffer)>,
    /// Three words per element of `indirect`.
    readback: Buffer,
    begun: Instant,
}

const GRID_BYTES: u64 = 12;

impl Commands {
    pub(super) fn begin(inner: &Arc<Device>, log: Arc<Log>) -> Result<Self> {
        let begun = Instant::now();
        let spare = log.spare.lock().unwrap_or_else(PoisonError::into_inner).pop();
        let readback = match spare {
            Some(buffer) => buffer,
            None => {
                let request = [("indirect_arguments", u64::from(MAX_COMMANDS) * GRID_BYTES)];
                inner.allocate("profile", &request, MemoryKind::HostVisible, 0)?.swap_remove(0)
            }
        };
        Ok(Self { log, records: Vec::new(), indirect: Vec::new(), readback, begun })
    }

    /// Adds a record and returns its index.
    pub(super) fn push(&mut self, record: CommandRecord) -> u32 {
        self.records.push(record);
        self.records.len() as u32 - 1
    }

    /// Marks the last record as an indirect dispatch.
    pub(super) fn is_indirect(&mut self, arguments: &Buffer) {
        if self.indirect.len() < MAX_COMMANDS as usize
            && let Some(last) = self.records.len().checked_sub(1)
        {
            self.indirect.push((last, arguments.range(0, GRID_BYTES)));
        }
    }

    /// Returns the copies to record after all other commands, so that no command's time includes them.
    pub(super) fn copies(&self) -> impl Iterator<Item = (&Buffer, Buffer)> {
        self.indirect
            .iter()
            .enumerate()
            .map(|(i, (_, from))| (from, self.readback.range(i as u64 * GRID_BYTES, GRID_BYTES)))
    }

    /// Returns the records, with the grids of indirect dispatches. The submission must have been waited for.
    pub(super) fn take(&mut self) -> Vec<CommandRecord> {
        let mut records = std::mem::take(&mut self.records);
        for (i, (record, _)) in self.indirect.iter().enumerate() {
            let mut bytes = [0u8; GRID_BYTES as usize];
            let offset = self.readback.offset() + i as u64 * GRID_BYTES;
            if self.readback.block().read_mapped(offset, &mut bytes) {
                records[*record].workgroups = Some(bytemuck::pod_read_unaligned(&bytes));
            }
        }
        self.indirect.clear();
        records
    }

    /// Adds the submission to the log.
    pub(super) fn log(self, inner: &Device, label: String, host: HostTimes, collected: Collected) {
        let HostTimes { submitting, submitted, done } = host;
        let calibrated = inner.now_on_both_clocks();
        let begin = collected.begin_ticks;
        let device_begun = match (collected.nanoseconds, calibrated) {
            (None, _) => None,
            (Some(_), Some(clocks)) => {
                clocks.host.checked_sub(nanoseconds(inner.nanoseconds_between(begin, clocks.ticks)))
            }
            (Some(whole), None) => done.checked_sub(nanoseconds(whole)),
        };
        let calibrated = calibrated.filter(|_| device_begun.is_some());
        let submission = Submission {
            label,
            commands: collected.commands,
            scopes: collected.scopes,
            nanoseconds: collected.nanoseconds,
            begun: self.begun,
            submitting,
            submitted,
            done,
            device_begun,
            calibrated: calibrated.is_some(),
            calibration_error: calibrated.map_or(Duration::ZERO, |clocks| clocks.error),
        };
        self.log.submissions.lock().unwrap_or_else(PoisonError::into_inner).push(submission);
        self.log.spare.lock().unwrap_or_else(PoisonError::into_inner).push(self.readback);
    }
}

/// Device clock and host clock at the same moment, within an error.
#[derive(Clone, Copy)]
struct Clocks {
    ticks: u64,
    host: Instant,
    error: Duration,
}

fn nanoseconds(n: f64) -> Duration {
    Duration::from_nanos(n.max(0.0) as u64)
}

/// Host times of a submission.
#[derive(Clone, Copy)]
pub(super) struct HostTimes {
    pub(super) submitting: Instant,
    pub(super) submitted: Instant,
    pub(super) done: Instant,
}

impl Device {
    /// Nanoseconds between two timestamps of the device.
    pub(super) fn nanoseconds_between(&self, begin: u64, end: u64) -> f64 {
        let bits = self.timestamp_bits;
        let mask = if bits >= 64 { u64::MAX } else { (1 << bits) - 1 };
        (end.wrapping_sub(begin) & mask) as f64 * self.limits.timestamp_period_ns
    }

    /// Reads both clocks at one moment; None if timestamps cannot be calibrated.
    fn now_on_both_clocks(&self) -> Option<Clocks> {
        let clock = self.clock.as_ref()?;
        // An interruption between two readings would offset them by milliseconds, so the closest pair counts.
        let readings = (0..CLOCK_READINGS).map(|_| {
            let before = Instant::now();
            let ticks = clock.ticks()?;
            let error = before.elapsed() / 2;
            Some(Clocks { ticks, host: before + error, error })
        });
        readings.collect::<Option<Vec<_>>>()?.into_iter().min_by_key(|clocks| clocks.error)
    }
}

impl Profile {
    /// Returns the submissions that ended since the last call, oldest first.
    pub fn take(&self) -> Vec<Submission> {
        std::mem::take(&mut *self.log.submissions.lock().unwrap_or_else(PoisonError::into_inner))
    }
}
