//! The opt-in profile of a context: every command of every submission, with its resources and its time.

use super::access::Access;
use super::allocator::MemoryKind;
use super::buffer::Buffer;
use super::open_device::Device;
use crate::Result;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Most timed commands of one profiled recording.
pub(super) const MAX_COMMANDS: u32 = 1024;

/// How often both clocks are read for each submission.
const CLOCK_READINGS: u32 = 3;

/// While it exists, all submissions of its context are recorded command by command. It costs a timestamp per
/// command; without a profile there is no cost.
pub struct Profile {
    pub(super) log: Arc<Log>,
}

/// How long the commands of a scope took on the device.
#[derive(Clone, Debug, PartialEq)]
pub struct ScopeTime {
    /// The name given to [`super::Recorder::scope`].
    pub name: String,
    /// Its nesting depth.
    pub depth: u32,
    /// From the end of the previous work to the end of its own commands.
    pub nanoseconds: f64,
}

/// A submission that has finished.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct Submission {
    /// The label given to [`Context::begin`](super::Context::begin) or [`Context::run`](super::Context::run).
    pub label: String,
    /// Its commands in the order of recording.
    pub commands: Vec<CommandRecord>,
    /// Its scopes, as in [`super::RunReport`].
    pub scopes: Vec<ScopeTime>,
    /// Its time on the device; None without timestamps.
    pub nanoseconds: Option<f64>,
    /// When the recording began, on the host.
    pub begun: Instant,
    /// When recording had ended and submitting began.
    pub submitting: Instant,
    /// When the driver had accepted it.
    pub submitted: Instant,
    /// When the host knew that it had finished.
    pub done: Instant,
    /// When the device began it, on the host's clock; None without timestamps.
    pub device_begun: Option<Instant>,
    /// Whether `device_begun` comes from calibrated timestamps. Otherwise the device is assumed to have
    /// finished at `done`, which is late by the time it takes to wake the host.
    pub calibrated: bool,
    /// How far `device_begun` may be off where it is calibrated: half of the time that reading both clocks took.
    /// Zero where it is not.
    pub calibration_error: Duration,
}

/// A command of a recording.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct CommandRecord {
    /// The kernel's name, or "fill", "copy" or "update".
    pub name: &'static str,
    /// The innermost scope around it; empty without a scope.
    pub scope: String,
    /// The grid of a dispatch. For an indirect dispatch: its arguments at the end of the recording.
    pub workgroups: Option<[u32; 3]>,
    /// Its buffers.
    pub buffers: Vec<BoundBuffer>,
    /// Barriers recorded since the command before it: with any, it waits for all commands before them.
    pub barriers: u32,
    /// Its begin, nanoseconds from the recording's begin on the device; None without timestamps.
    pub begin_ns: Option<f64>,
    /// From the end of the previous command to its own end, including the barrier between them; None without
    /// timestamps.
    pub nanoseconds: Option<f64>,
}

/// A buffer as a command sees it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BoundBuffer {
    /// Its name in the kernel.
    pub role: &'static str,
    /// The name of its allocation.
    pub name: &'static str,
    /// How the command may access it.
    pub access: Access,
    /// Bytes bound: its capacity, not the bytes accessed.
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

/// The device times of a recording.
#[derive(Default)]
pub(super) struct Collected {
    /// The whole recording; None without timestamps.
    pub(super) nanoseconds: Option<f64>,
    pub(super) scopes: Vec<ScopeTime>,
    pub(super) commands: Vec<CommandRecord>,
    /// The device's clock at the recording's begin, ticks.
    pub(super) begin_ticks: u64,
}

/// The log of submissions, and memory for the arguments of indirect dispatches.
#[derive(Default)]
pub(super) struct Log {
    submissions: Mutex<Vec<Submission>>,
    spare: Mutex<Vec<Buffer>>,
}

/// The commands of a current recording.
pub(super) struct Commands {
    log: Arc<Log>,
    records: Vec<CommandRecord>,
    /// For each indirect dispatch its record and its arguments.
    indirect: Vec<(usize, Buffer)>,
    /// Three words for each of `indirect`.
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

    /// The index of the new record.
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

    /// Copies to record after all other commands, so that they do not count in any command's time.
    pub(super) fn copies(&self) -> impl Iterator<Item = (&Buffer, Buffer)> {
        self.indirect
            .iter()
            .enumerate()
            .map(|(i, (_, from))| (from, self.readback.range(i as u64 * GRID_BYTES, GRID_BYTES)))
    }

    /// The records, with the grids of indirect dispatches. The submission must have been waited for.
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

    /// Writes the submission into the log.
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

/// The device's clock, and the host's at the same moment but for an error.
#[derive(Clone, Copy)]
struct Clocks {
    ticks: u64,
    host: Instant,
    error: Duration,
}

fn nanoseconds(n: f64) -> Duration {
    Duration::from_nanos(n.max(0.0) as u64)
}

/// The host's times of a submission.
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

    /// Both clocks at one moment; None if timestamps cannot be calibrated.
    fn now_on_both_clocks(&self) -> Option<Clocks> {
        let clock = self.clock.as_ref()?;
        // A thread that is interrupted between the readings would make them differ by milliseconds: the closest counts.
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
    /// The submissions that ended since the last call, oldest first.
    pub fn take(&self) -> Vec<Submission> {
        std::mem::take(&mut *self.log.submissions.lock().unwrap_or_else(PoisonError::into_inner))
    }
}
