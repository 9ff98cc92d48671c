//! Timestamps around scopes.

use super::context::Inner;
use super::vk_error;
use crate::Result;
use ash::vk;

/// Scopes of one recording that are timed; later ones are only labelled.
pub(super) const MAX_SCOPES: u32 = 256;

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
}

impl Profiler {
    /// `pool` has two queries for each of [`MAX_SCOPES`], all reset, or is null where there are no timestamps.
    pub(super) fn new(pool: vk::QueryPool) -> Self {
        Self { pool, names: Vec::new(), open: Vec::new() }
    }

    pub(super) fn begin(&mut self, inner: &Inner, commands: vk::CommandBuffer, name: &str) {
        inner.names.begin_label(commands, name);
        let index = self.names.len() as u32;
        let timed = self.pool != vk::QueryPool::null() && index < MAX_SCOPES;
        if timed {
            self.names.push((name.to_owned(), self.open.len() as u32));
            self.write(inner, commands, 2 * index);
        }
        self.open.push(timed.then_some(index));
    }

    pub(super) fn end(&mut self, inner: &Inner, commands: vk::CommandBuffer) {
        if let Some(Some(index)) = self.open.pop() {
            self.write(inner, commands, 2 * index + 1);
        }
        inner.names.end_label(commands);
    }

    fn write(&self, inner: &Inner, commands: vk::CommandBuffer, query: u32) {
        // At ALL_COMMANDS: the time at which everything recorded before is done.
        // SAFETY: `commands` is in the recording state; the query was reset and is written once.
        unsafe {
            let stage = vk::PipelineStageFlags2::ALL_COMMANDS;
            inner.device.cmd_write_timestamp2(commands, stage, self.pool, query);
        }
    }

    /// The whole recording's time and that of each scope. The submission must have been waited for.
    pub(super) fn collect(self, inner: &Inner) -> Result<(f64, Vec<ScopeTime>)> {
        if self.names.is_empty() {
            return Ok((0.0, Vec::new()));
        }
        let mut ticks = vec![0u64; 2 * self.names.len()];
        // SAFETY: these queries were written by a submission that is over.
        let read = unsafe {
            inner.device.get_query_pool_results(self.pool, 0, &mut ticks, vk::QueryResultFlags::TYPE_64)
        };
        read.map_err(vk_error("vkGetQueryPoolResults"))?;
        let bits = inner.timestamp_bits;
        let mask = if bits >= 64 { u64::MAX } else { (1 << bits) - 1 };
        let times = ticks.chunks_exact(2).map(|t| {
            let ticks = t[1].wrapping_sub(t[0]) & mask;
            ticks as f64 * inner.limits.timestamp_period_ns
        });
        let mut scopes = self.names.into_iter().zip(times).map(|((name, depth), nanoseconds)| ScopeTime {
            name,
            depth: depth.saturating_sub(1),
            nanoseconds,
        });
        let whole = scopes.next().map_or(0.0, |s| s.nanoseconds);
        Ok((whole, scopes.collect()))
    }
}
