//! Timestamps around scopes, and behind every command while a [`super::Profile`] is held.

use super::context::Inner;
use super::profile::{CommandRecord, Commands};
use super::vk_error;
use crate::Result;
use ash::vk;

/// Scopes of one recording that are timed; later ones are only labelled.
pub(super) const MAX_SCOPES: u32 = 256;
/// Commands of one profiled recording that are timed one by one.
pub(super) const MAX_COMMANDS: u32 = 1024;
/// Queries of a recording: two for each scope, then one for each command.
pub(super) const QUERIES: u32 = 2 * MAX_SCOPES + MAX_COMMANDS;

/// How long the commands of a scope took on the device.
#[derive(Clone, Debug, PartialEq)]
pub struct ScopeTime {
    /// The name given to [`super::Recorder::scope`].
    pub name: String,
    /// How many scopes it lies in.
    pub depth: u32,
    /// From the end of what came before it to the end of its own commands.
    pub nanoseconds: f64,
}

/// The scopes of a recording. Scope 0 is the whole recording.
pub(super) struct Profiler {
    pool: vk::QueryPool,
    names: Vec<(String, u32)>,
    open: Vec<Option<u32>>,
    /// Present while a profile is held.
    pub(super) commands: Option<Commands>,
}

/// What a recording took on the device.
#[derive(Default)]
pub(super) struct Collected {
    /// The whole recording; None where there are no timestamps.
    pub(super) nanoseconds: Option<f64>,
    pub(super) scopes: Vec<ScopeTime>,
    pub(super) commands: Vec<CommandRecord>,
    /// The device's clock at the recording's begin, ticks.
    pub(super) begin_ticks: u64,
}

impl Profiler {
    /// `pool` has [`QUERIES`] queries, all reset, or is null where there are no timestamps.
    pub(super) fn new(pool: vk::QueryPool, commands: Option<Commands>) -> Self {
        Self { pool, names: Vec::new(), open: Vec::new(), commands }
    }

    pub(super) fn begin(&mut self, inner: &Inner, commands: vk::CommandBuffer, name: &str) {
        inner.names.begin_label(commands, name);
        let index = self.names.len() as u32;
        let timed = index < MAX_SCOPES && (self.pool != vk::QueryPool::null() || self.commands.is_some());
        if timed {
            self.names.push((name.to_owned(), self.open.len() as u32));
            self.write(inner, commands, 2 * index);
        }
        self.open.push(timed.then_some(index));
    }

    /// The name of the whole recording.
    pub(super) fn label(&self) -> String {
        let wanted = self.commands.is_some();
        self.names.first().filter(|_| wanted).map_or_else(String::new, |(name, _)| name.clone())
    }

    pub(super) fn end(&mut self, inner: &Inner, commands: vk::CommandBuffer) {
        if let Some(Some(index)) = self.open.pop() {
            self.write(inner, commands, 2 * index + 1);
        }
        inner.names.end_label(commands);
    }

    /// Notes a command that was just recorded, and when it is over.
    pub(super) fn command(
        &mut self,
        inner: &Inner,
        raw: vk::CommandBuffer,
        describe: impl FnOnce() -> CommandRecord,
    ) {
        let Some(commands) = &mut self.commands else { return };
        let scope = self.open.last().copied().flatten().filter(|&index| index > 0);
        let scope = scope.map_or_else(String::new, |index| self.names[index as usize].0.clone());
        let index = commands.push(CommandRecord { scope, ..describe() });
        if index < MAX_COMMANDS {
            self.write(inner, raw, 2 * MAX_SCOPES + index);
        }
    }

    fn write(&self, inner: &Inner, commands: vk::CommandBuffer, query: u32) {
        if self.pool == vk::QueryPool::null() {
            return;
        }
        // At ALL_COMMANDS: the time at which everything recorded before is done.
        // SAFETY: `commands` is in the recording state; the query was reset and is written once.
        unsafe {
            let stage = vk::PipelineStageFlags2::ALL_COMMANDS;
            inner.device.cmd_write_timestamp2(commands, stage, self.pool, query);
        }
    }

    /// The times of the whole recording, of each scope and of each command. The submission must have been waited for.
    pub(super) fn collect(&mut self, inner: &Inner) -> Result<Collected> {
        let mut commands = self.commands.as_mut().map_or_else(Vec::new, Commands::take);
        if self.names.is_empty() || self.pool == vk::QueryPool::null() {
            return Ok(Collected { commands, ..Collected::default() });
        }
        let ticks = self.read(inner, 0, 2 * self.names.len())?;
        let times = ticks.chunks_exact(2).map(|t| inner.nanoseconds_between(t[0], t[1]));
        let names = std::mem::take(&mut self.names);
        let mut scopes = names.into_iter().zip(times).map(|((name, depth), nanoseconds)| ScopeTime {
            name,
            depth: depth.saturating_sub(1),
            nanoseconds,
        });
        let whole = scopes.next().map(|s| s.nanoseconds);
        let timed = commands.len().min(MAX_COMMANDS as usize);
        let mut before = ticks[0];
        for (command, end) in commands.iter_mut().zip(self.read(inner, 2 * MAX_SCOPES, timed)?) {
            command.begin_ns = Some(inner.nanoseconds_between(ticks[0], before));
            command.nanoseconds = Some(inner.nanoseconds_between(before, end));
            before = end;
        }
        Ok(Collected { nanoseconds: whole, scopes: scopes.collect(), commands, begin_ticks: ticks[0] })
    }

    fn read(&self, inner: &Inner, first: u32, count: usize) -> Result<Vec<u64>> {
        let mut ticks = vec![0u64; count];
        if count > 0 {
            let flags = vk::QueryResultFlags::TYPE_64;
            // SAFETY: these queries were written by a submission that is over.
            let read = unsafe { inner.device.get_query_pool_results(self.pool, first, &mut ticks, flags) };
            read.map_err(vk_error("vkGetQueryPoolResults"))?;
        }
        Ok(ticks)
    }
}
