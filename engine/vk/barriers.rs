//! Barriers of a recording, and the stages that they order.
//!
//! [`Recorder::barrier`](super::Recorder::barrier) orders all earlier commands before all later ones. It is recorded with the
//! first command behind it, and only this command's stages wait; a command with another stage waits by a barrier of its own.
//! So every stage in use waits for every stage that was in use before, and waits for still earlier commands by the chain.
//! The arguments of an indirect dispatch are waited for only if an earlier command may have written them.

use super::memory::Buffer;
use ash::vk::{self, AccessFlags2 as Access, PipelineStageFlags2 as Stage};

pub(super) const COMPUTE: Stage = Stage::COMPUTE_SHADER;
pub(super) const TRANSFER: Stage = Stage::ALL_TRANSFER;
const ARGUMENTS: Stage = Stage::DRAW_INDIRECT;

/// Most ranges that are compared with the arguments of indirect dispatches. Recording takes nothing from the heap.
const MAX_WRITTEN: usize = 32;

/// Vulkan's buffer and the bytes there, or anywhere.
#[derive(Clone, Copy, Default)]
struct BufferRange {
    buffer: vk::Buffer,
    begin: u64,
    end: u64,
    is_anywhere: bool,
}

#[derive(Default)]
pub(super) struct Barriers {
    /// True from a barrier to the next command.
    is_due: bool,
    /// Stages of the commands before the last barrier.
    before: Stage,
    /// Stages of the commands after it.
    after: Stage,
    /// Stages that wait for the commands before it.
    waiting: Stage,
    /// Written since indirect arguments were last waited for; the first `written`.
    written_ranges: [BufferRange; MAX_WRITTEN],
    written: usize,
    /// Number of ranges that were written before the last barrier.
    settled: usize,
}

impl Barriers {
    /// For a recording after commands of these stages that it must wait for. They may have written indirect arguments.
    pub(super) fn after(stages: Stage) -> Self {
        let mut barriers = Self { after: stages, written: 1, ..Self::default() };
        barriers.written_ranges[0].is_anywhere = true;
        barriers
    }

    /// Orders all earlier commands before all later ones.
    pub(super) fn add(&mut self) {
        self.is_due = true;
    }

    /// Notes that a command was recorded that writes a buffer.
    pub(super) fn note_write(&mut self, buffer: &Buffer) {
        if self.written < MAX_WRITTEN {
            self.written_ranges[self.written] = BufferRange::of(buffer);
            self.written += 1;
        } else {
            self.written_ranges[MAX_WRITTEN - 1].is_anywhere = true;
            self.settled = self.settled.min(MAX_WRITTEN - 1);
        }
    }

    /// Returns the stages of a dispatch by these arguments.
    pub(super) fn stages_of_indirect(&self, arguments: &Buffer) -> Stage {
        let own = BufferRange::of(arguments);
        match self.written_ranges[..self.written].iter().any(|range| range.overlaps(&own)) {
            true => COMPUTE | ARGUMENTS,
            false => COMPUTE,
        }
    }

    /// Adds a command of these stages. Returns the barrier to record before it, if there must be one.
    pub(super) fn order(&mut self, stages: Stage) -> Option<vk::MemoryBarrier2<'static>> {
        // The last barrier serves if no command was recorded since.
        if std::mem::take(&mut self.is_due) && !self.after.is_empty() {
            (self.before, self.after, self.waiting) = (self.after, Stage::NONE, Stage::NONE);
            self.settled = self.written;
        }
        // A barrier after the compute stage also waits for the reading of the arguments, an earlier stage.
        self.after |= stages & !ARGUMENTS;
        let new = stages & !self.waiting;
        if new.is_empty() || self.before.is_empty() {
            return None;
        }
        self.waiting |= new;
        if new.contains(ARGUMENTS) {
            self.written_ranges.copy_within(self.settled..self.written, 0);
            self.written -= std::mem::take(&mut self.settled);
        }
        let barrier = vk::MemoryBarrier2::default().src_stage_mask(self.before).dst_stage_mask(new);
        Some(barrier.src_access_mask(writes(self.before)).dst_access_mask(reads(new) | writes(new)))
    }
}

impl BufferRange {
    fn of(buffer: &Buffer) -> Self {
        let begin = buffer.offset();
        Self { buffer: buffer.raw(), begin, end: begin + buffer.bytes(), is_anywhere: false }
    }

    fn overlaps(&self, other: &Self) -> bool {
        self.is_anywhere || self.buffer == other.buffer && self.begin < other.end && other.begin < self.end
    }
}

/// Returns the accesses in a list of stages and accesses of the stages that are in use.
fn accesses<const N: usize>(stages: Stage, all: [(Stage, Access); N]) -> Access {
    let used = all.into_iter().filter(|(stage, _)| stages.contains(*stage));
    used.fold(Access::NONE, |accesses, (_, access)| accesses | access)
}

fn writes(stages: Stage) -> Access {
    accesses(stages, [(COMPUTE, Access::SHADER_WRITE), (TRANSFER, Access::TRANSFER_WRITE)])
}

fn reads(stages: Stage) -> Access {
    let by_shaders = Access::SHADER_READ | Access::UNIFORM_READ;
    let of_arguments = (ARGUMENTS, Access::INDIRECT_COMMAND_READ);
    accesses(stages, [(COMPUTE, by_shaders), (TRANSFER, Access::TRANSFER_READ), of_arguments])
}
