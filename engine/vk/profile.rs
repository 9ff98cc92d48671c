//! Opt-in profile of a context: every command of every submission, with its resources and its time.

use super::debug::vk_error;
use super::format::Access;
use super::lock::lock;
use super::memory::Buffer;
use super::memory_types::MemoryKind;
use super::open_device::Device;
use crate::error::Result;
use ash::vk;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// Most timed commands of one profiled recording.
pub(super) const MAX_COMMANDS: u32 = 1024;

/// Records all submissions of its context but staged uploads, command by command, until it is dropped. It costs a timestamp per
/// command; without a profile there is no cost.
pub struct Profile {
    pub(super) log: Arc<Log>,
}

/// Device time of a scope's commands.
#[derive(Clone, Debug, PartialEq)]
pub struct ScopeTime {
    /// The name given to [`super::Recorder::scope`].
    pub name: &'static str,
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
    pub label: &'static str,
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
    /// Host time when the device began it; None without timestamps. Assumes that it ended at `done`, which is late by the time
    /// that it takes to wake the host.
    pub device_begun: Option<Instant>,
}

/// A command of a recording.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct CommandRecord {
    /// The kernel's name, or "fill", "copy" or "update".
    pub name: &'static str,
    /// Innermost scope around it; empty without a scope.
    pub scope: &'static str,
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
    /// Name of the binding in the kernel.
    pub role: &'static str,
    /// Name of the buffer's allocation.
    pub name: &'static str,
    /// How the command may access it.
    pub access: Access,
    /// Bytes bound: the capacity, not the bytes accessed.
    pub bytes: u64,
}

#[derive(Default)]
pub(super) struct Collected {
    /// Time of the whole recording; None without timestamps.
    pub(super) nanoseconds: Option<f64>,
    pub(super) scopes: Vec<ScopeTime>,
    pub(super) commands: Vec<CommandRecord>,
}

/// Log of submissions, and memory for the arguments of indirect dispatches.
#[derive(Default)]
pub(super) struct Log {
    submissions: Mutex<Vec<Submission>>,
    spare: Mutex<Vec<Buffer>>,
}

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
        let request = [("indirect_arguments", u64::from(MAX_COMMANDS) * GRID_BYTES)];
        let spare = lock(&log.spare).pop();
        let readback = match spare {
            Some(buffer) => buffer,
            None => inner.allocate("profile", &request, &[], MemoryKind::HostVisible, 0)?.swap_remove(0),
        };
        Ok(Self { log, records: Vec::new(), indirect: Vec::new(), readback, begun })
    }

    pub(super) fn is_indirect(&mut self, arguments: &Buffer) {
        if self.indirect.len() < MAX_COMMANDS as usize
            && let Some(last) = self.records.len().checked_sub(1)
        {
            self.indirect.push((last, arguments.range(0, GRID_BYTES)));
        }
    }

    /// Returns the copies to record after all other commands, so that no command's time includes them.
    pub(super) fn copies(&self) -> impl Iterator<Item = (&Buffer, Buffer)> {
        (self.indirect.iter().zip(0..)).map(|((_, from), i)| (from, self.grid(i)))
    }

    /// Returns where the grid of an indirect dispatch is read back.
    fn grid(&self, indirect: u64) -> Buffer {
        self.readback.range(indirect * GRID_BYTES, GRID_BYTES)
    }

    /// Returns the records, with the grids of indirect dispatches. The submission must have been waited for.
    pub(super) fn take(&mut self) -> Vec<CommandRecord> {
        let mut records = std::mem::take(&mut self.records);
        for ((record, _), i) in self.indirect.iter().zip(0..) {
            let mut bytes = [0u8; GRID_BYTES as usize];
            let grid = self.grid(i);
            if grid.block().read_mapped(grid.offset(), &mut bytes) {
                records[*record].workgroups = Some(bytemuck::pod_read_unaligned(&bytes));
            }
        }
        self.indirect.clear();
        records
    }

    /// Adds the submission to the log. Its times on the host are `submitting`, `submitted` and `done`.
    pub(super) fn log(
        self,
        label: &'static str,
        [submitting, submitted, done]: [Instant; 3],
        collected: Collected,
    ) {
        let ago = |whole: f64| done.checked_sub(Duration::from_nanos(whole as u64));
        lock(&self.log.submissions).push(Submission {
            label,
            commands: collected.commands,
            scopes: collected.scopes,
            nanoseconds: collected.nanoseconds,
            begun: self.begun,
            submitting,
            submitted,
            done,
            device_begun: collected.nanoseconds.and_then(ago),
        });
        lock(&self.log.spare).push(self.readback);
    }
}

impl Device {
    /// Creates a pool of timestamp queries; null without timestamps.
    pub(super) fn create_queries(&self, count: u32, name: &str) -> Result<vk::QueryPool> {
        if self.timestamp_bits == 0 {
            return Ok(vk::QueryPool::null());
        }
        let info = vk::QueryPoolCreateInfo::default().query_type(vk::QueryType::TIMESTAMP).query_count(count);
        // SAFETY: a valid create info for this device.
        let pool = unsafe { self.device.create_query_pool(&info, None) };
        let pool = pool.map_err(vk_error("vkCreateQueryPool"))?;
        self.names.name(pool, name);
        Ok(pool)
    }

    pub(super) fn nanoseconds_between(&self, begin: u64, end: u64) -> f64 {
        let bits = self.timestamp_bits;
        let mask = if bits >= 64 { u64::MAX } else { (1 << bits) - 1 };
        (end.wrapping_sub(begin) & mask) as f64 * self.limits.timestamp_period_ns
    }
}

impl Profile {
    /// Returns the submissions that ended since the last call, oldest first.
    pub fn take(&self) -> Vec<Submission> {
        std::mem::take(&mut *lock(&self.log.submissions))
    }
}

// Timestamps around scopes, and after every command while a [`super::Profile`] exists.

/// Most timed scopes of one recording. Later ones are only labelled.
pub(super) const MAX_SCOPES: u32 = 256;
/// Queries of a recording: two for each scope, then one for each command.
pub(super) const QUERIES: u32 = 2 * MAX_SCOPES + MAX_COMMANDS;

/// Scopes of a recording. Scope 0 is the whole recording.
#[derive(Default)]
pub(super) struct Profiler {
    pool: vk::QueryPool,
    scopes: Vec<Scope>,
    open: Vec<Option<usize>>,
    /// Number of timestamps written so far; they take the pool's queries in order.
    written: u32,
    /// True if nothing was recorded since the last timestamp, so that it can be reused.
    fresh: bool,
    /// True if the recording follows a host's commands. After a render pass, llvmpipe writes a timestamp with the next
    /// flush, as it does for draws. A dispatch recorded after it may run before. A barrier flushes.
    behind_host: bool,
    /// Present while a profile is held.
    pub(super) commands: Option<Commands>,
    /// Timestamp after each timed command.
    command_ends: Vec<u32>,
    /// Barriers of the recording up to the last command that was added.
    barriers: u32,
}

struct Scope {
    name: &'static str,
    depth: u32,
    begin: u32,
    end: u32,
}

impl Profiler {
    /// `pool` has [`QUERIES`] queries, all reset, or is null without timestamps.
    pub(super) fn new(pool: vk::QueryPool, commands: Option<Commands>) -> Self {
        Self { pool, commands, ..Self::default() }
    }

    /// For a recording behind a host's commands. Reuses the memory of a finished recording.
    pub(super) fn again(self, pool: vk::QueryPool) -> Self {
        let Self { mut scopes, mut open, mut command_ends, .. } = self;
        scopes.clear();
        open.clear();
        command_ends.clear();
        Self { pool, scopes, open, command_ends, behind_host: true, ..Self::default() }
    }

    pub(super) fn begin(&mut self, inner: &Device, commands: vk::CommandBuffer, name: &'static str) {
        inner.names.begin_label(commands, name);
        let index = self.scopes.len();
        let timed =
            index < MAX_SCOPES as usize && (self.pool != vk::QueryPool::null() || self.commands.is_some());
        if timed {
            let (depth, begin) = (self.open.len() as u32, self.now(inner, commands));
            self.scopes.push(Scope { name, depth, begin, end: begin });
        }
        self.open.push(timed.then_some(index));
    }

    /// Returns the name of the whole recording; empty without a profile.
    pub(super) fn label(&self) -> &'static str {
        self.scopes.first().filter(|_| self.commands.is_some()).map_or("", |whole| whole.name)
    }

    pub(super) fn end(&mut self, inner: &Device, commands: vk::CommandBuffer) {
        if let Some(Some(index)) = self.open.pop() {
            self.scopes[index].end = self.now(inner, commands);
        }
        inner.names.end_label(commands);
    }

    /// Adds a command that was just recorded, and its end. `barriers`: number of barriers in the recording so far.
    pub(super) fn command(
        &mut self,
        inner: &Device,
        raw: vk::CommandBuffer,
        barriers: u32,
        describe: impl FnOnce() -> CommandRecord,
    ) {
        self.fresh = false;
        let Some(commands) = &mut self.commands else { return };
        let scope = self.open.last().copied().flatten().filter(|&index| index > 0);
        let scope = scope.map_or("", |index| self.scopes[index].name);
        let waits = barriers - std::mem::replace(&mut self.barriers, barriers);
        commands.records.push(CommandRecord { scope, barriers: waits, ..describe() });
        if self.command_ends.len() < MAX_COMMANDS as usize {
            let end = self.now(inner, raw);
            self.command_ends.push(end);
        }
    }

    /// Returns a timestamp after everything recorded so far. Writes a new one only if commands followed the last one,
    /// because each timestamp stalls the device.
    fn now(&mut self, inner: &Device, commands: vk::CommandBuffer) -> u32 {
        if self.fresh {
            return self.written - 1;
        }
        if self.pool != vk::QueryPool::null() {
            let (in_order, all) = (inner.limits.tuning.runs_in_order, vk::PipelineStageFlags2::ALL_COMMANDS);
            // If commands run in order, a top-of-pipe timestamp marks the end of all earlier commands.
            let stage = if in_order { vk::PipelineStageFlags2::TOP_OF_PIPE } else { all };
            // SAFETY: `commands` is in the recording state; the query was reset and is written once.
            unsafe { inner.device.cmd_write_timestamp2(commands, stage, self.pool, self.written) }
            if self.behind_host && in_order {
                let barrier = vk::MemoryBarrier2::default().src_stage_mask(all).dst_stage_mask(all);
                inner.barrier(commands, &vk::DependencyInfo::default().memory_barriers(&[barrier]));
            }
        }
        self.fresh = true;
        self.written += 1;
        self.written - 1
    }

    /// True if all timestamps are available. Never waits.
    pub(super) fn is_ready(&self, inner: &Device) -> Result<bool> {
        if self.written == 0 || self.pool == vk::QueryPool::null() {
            return Ok(true);
        }
        match self.read(inner) {
            Ok(_) => Ok(true),
            Err(vk::Result::NOT_READY) => Ok(false),
            Err(error) => Err(vk_error("vkGetQueryPoolResults")(error)),
        }
    }

    /// Returns the times of the whole recording, of each scope and of each command. The submission must have been waited
    /// for.
    pub(super) fn collect(&mut self, inner: &Device) -> Result<Collected> {
        let mut commands = self.commands.as_mut().map_or_else(Vec::new, Commands::take);
        if self.scopes.is_empty() || self.pool == vk::QueryPool::null() {
            return Ok(Collected { commands, ..Collected::default() });
        }
        let ticks = self.read(inner).map_err(vk_error("vkGetQueryPoolResults"))?;
        let between =
            |begin: u32, end: u32| inner.nanoseconds_between(ticks[begin as usize], ticks[end as usize]);
        let mut scopes = self.scopes.iter().map(|scope| ScopeTime {
            depth: scope.depth.saturating_sub(1),
            nanoseconds: between(scope.begin, scope.end),
            name: scope.name,
        });
        let whole = scopes.next().map(|s| s.nanoseconds);
        let mut before = 0;
        for (command, &end) in commands.iter_mut().zip(&self.command_ends) {
            command.begin_ns = Some(between(0, before));
            command.nanoseconds = Some(between(before, end));
            before = end;
        }
        Ok(Collected { nanoseconds: whole, scopes: scopes.collect(), commands })
    }

    fn read(&self, inner: &Device) -> Result<Vec<u64>, vk::Result> {
        let mut ticks = vec![0u64; self.written as usize];
        let flags = vk::QueryResultFlags::TYPE_64;
        // SAFETY: the recording has reset these queries.
        let read = unsafe { inner.device.get_query_pool_results(self.pool, 0, &mut ticks, flags) };
        read.map(|()| ticks)
    }
}
