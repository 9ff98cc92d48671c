//! Timestamps around scopes, and after every command while a [`super::Profile`] exists.

use super::error::vk_error;
use super::open_device::Device;
use super::profile::{Collected, CommandRecord, Commands, MAX_COMMANDS, ScopeTime};
use crate::Result;
use ash::vk;

/// Most timed scopes of one recording. Later ones are only labelled.
pub(super) const MAX_SCOPES: u32 = 256;
/// Queries of a recording: two for each scope, then one for each command.
pub(super) const QUERIES: u32 = 2 * MAX_SCOPES + MAX_COMMANDS;

/// Scopes of a recording. Scope 0 is the whole recording.
pub(super) struct Profiler {
    pool: vk::QueryPool,
    /// The first [`Profiler::used`] belong to this recording. The others keep their names' memory for reuse.
    scopes: Vec<Scope>,
    used: usize,
    open: Vec<Option<usize>>,
    /// Number of timestamps written so far; they take the pool's queries in order.
    written: u32,
    /// True if nothing was recorded since the last timestamp, so that it can be reused.
    fresh: bool,
    /// True if the recording follows a host's commands. After a render pass, llvmpipe writes a timestamp with the next
    /// flush, as it does for draws. A dispatch recorded after it may run before. A barrier flushes.
    pub(super) behind_host: bool,
    /// Present while a profile is held.
    pub(super) commands: Option<Commands>,
    /// Timestamp after each timed command.
    command_ends: Vec<u32>,
    /// Barriers of the recording up to the last command that was added.
    barriers: u32,
}

struct Scope {
    name: String,
    depth: u32,
    begin: u32,
    end: u32,
}

impl Profiler {
    /// `pool` has [`QUERIES`] queries, all reset, or is null without timestamps.
    pub(super) fn new(pool: vk::QueryPool, commands: Option<Commands>) -> Self {
        Self {
            pool,
            scopes: Vec::new(),
            used: 0,
            open: Vec::new(),
            written: 0,
            fresh: false,
            behind_host: false,
            commands,
            command_ends: Vec::new(),
            barriers: 0,
        }
    }

    /// Same as [`Self::new`], but reuses the memory of a finished recording.
    pub(super) fn again(self, pool: vk::QueryPool) -> Self {
        let Self { scopes, mut open, mut command_ends, .. } = self;
        open.clear();
        command_ends.clear();
        Self { scopes, open, command_ends, ..Self::new(pool, None) }
    }

    pub(super) fn begin(&mut self, inner: &Device, commands: vk::CommandBuffer, name: &str) {
        inner.names.begin_label(commands, name);
        let index = self.used;
        let timed =
            index < MAX_SCOPES as usize && (self.pool != vk::QueryPool::null() || self.commands.is_some());
        if timed {
            let (depth, begin) = (self.open.len() as u32, self.now(inner, commands));
            match self.scopes.get_mut(index) {
                Some(scope) => {
                    scope.name.clear();
                    scope.name.push_str(name);
                    (scope.depth, scope.begin, scope.end) = (depth, begin, begin);
                }
                None => self.scopes.push(Scope { name: name.to_owned(), depth, begin, end: begin }),
            }
            self.used += 1;
        }
        self.open.push(timed.then_some(index));
    }

    /// Returns the name of the whole recording; empty without a profile.
    pub(super) fn label(&self) -> String {
        let wanted = self.commands.is_some();
        self.scopes[..self.used]
            .first()
            .filter(|_| wanted)
            .map_or_else(String::new, |scope| scope.name.clone())
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
        let scope = scope.map_or_else(String::new, |index| self.scopes[index].name.clone());
        let waits = barriers - std::mem::replace(&mut self.barriers, barriers);
        commands.push(CommandRecord { scope, barriers: waits, ..describe() });
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
            // SAFETY: `commands` is in the recording state; the query was reset and is written once.
            unsafe {
                // If commands run in order, a top-of-pipe timestamp marks the end of all earlier commands.
                let stage = match inner.limits.tuning.runs_in_order {
                    true => vk::PipelineStageFlags2::TOP_OF_PIPE,
                    false => vk::PipelineStageFlags2::ALL_COMMANDS,
                };
                inner.device.cmd_write_timestamp2(commands, stage, self.pool, self.written);
                if self.behind_host && inner.limits.tuning.runs_in_order {
                    let all = vk::PipelineStageFlags2::ALL_COMMANDS;
                    let barriers = [vk::MemoryBarrier2::default().src_stage_mask(all).dst_stage_mask(all)];
                    let dependency = vk::DependencyInfo::default().memory_barriers(&barriers);
                    inner.device.cmd_pipeline_barrier2(commands, &dependency);
                }
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
        if self.used == 0 || self.pool == vk::QueryPool::null() {
            return Ok(Collected { commands, ..Collected::default() });
        }
        let ticks = self.read(inner).map_err(vk_error("vkGetQueryPoolResults"))?;
        let between =
            |begin: u32, end: u32| inner.nanoseconds_between(ticks[begin as usize], ticks[end as usize]);
        let mut scopes = self.scopes[..self.used].iter().map(|scope| ScopeTime {
            depth: scope.depth.saturating_sub(1),
            nanoseconds: between(scope.begin, scope.end),
            name: scope.name.clone(),
        });
        let whole = scopes.next().map(|s| s.nanoseconds);
        let mut before = 0;
        for (command, &end) in commands.iter_mut().zip(&self.command_ends) {
            command.begin_ns = Some(between(0, before));
            command.nanoseconds = Some(between(before, end));
            before = end;
        }
        Ok(Collected { nanoseconds: whole, scopes: scopes.collect(), commands, begin_ticks: ticks[0] })
    }

    fn read(&self, inner: &Device) -> Result<Vec<u64>, vk::Result> {
        let mut ticks = vec![0u64; self.written as usize];
        let flags = vk::QueryResultFlags::TYPE_64;
        // SAFETY: the recording has reset these queries.
        let read = unsafe { inner.device.get_query_pool_results(self.pool, 0, &mut ticks, flags) };
        read.map(|()| ticks)
    }
}
