//! The ring of staging memory, for transfers when the host does not see device memory.
//!
//! Each context has one buffer, allocated at the first such transfer. An upload writes a piece of it and submits a copy,
//! without waiting: the host writes the next piece meanwhile. If the ring is full, it waits for the oldest copy. On devices
//! with a copy queue uploads run there. The main queue then acquires the copied data before its next
//! work.

use super::commands::{Commands, Pools};
use super::memory::{Buffer, PLACEMENT_ALIGNMENT};
use super::memory_types::MemoryKind;
use super::open_device::{CopyQueue, Device};
use crate::error::{Error, Result};
use ash::vk;
use std::collections::VecDeque;
use std::ops::Range;
use std::sync::Arc;

const RING_BYTES: u64 = 32 << 20;
/// Fewest bytes, if memory is bounded: larger than an update that a recording stores itself.
const MIN_RING_BYTES: u64 = 1 << 18;
/// Fewest pieces of a ring: the host writes one while the others are copied.
const PIECES: u64 = 4;

/// Buffer of the ring and the copies in flight.
#[derive(Default)]
pub(super) struct Ring {
    buffer: Option<Buffer>,
    /// Offset of the next piece.
    head: u64,
    running: VecDeque<Piece>,
    /// Buffers that the copy queue has released, and the main queue has not acquired yet.
    released: Vec<Buffer>,
}

struct Piece {
    // Dropped first: its drop waits.
    commands: Commands,
    /// Byte range in the ring; empty for an acquisition.
    bytes: Range<u64>,
    _kept: Vec<Buffer>,
}

impl Ring {
    /// Returns the ring's buffer; allocates it if there is none or it is too small. Pieces in flight keep the old one.
    fn buffer(&mut self, device: &Arc<Device>, bytes: u64) -> Result<Buffer> {
        let (max, min) = (max_ring_bytes(device), min_ring_bytes(device));
        let mut ring_bytes = (bytes * PIECES).clamp(MIN_RING_BYTES, RING_BYTES).min(max);
        if let Some(buffer) = self.buffer.as_ref().filter(|buffer| buffer.bytes() >= ring_bytes) {
            return Ok(buffer.clone());
        }
        // If memory is bounded, use what is left.
        loop {
            let made = device.allocate("staging", &[("ring", ring_bytes)], &[], MemoryKind::HostVisible, 0);
            match (made, &self.buffer) {
                (Ok(mut made), _) => {
                    let buffer = made.swap_remove(0);
                    // Offsets in the old buffer do not apply to the new one.
                    self.settle(device)?;
                    self.head = 0;
                    self.buffer = Some(buffer.clone());
                    return Ok(buffer);
                }
                (Err(Error::TooLarge { .. }), Some(smaller)) => return Ok(smaller.clone()),
                (Err(Error::TooLarge { .. }), None) if ring_bytes > min => {
                    ring_bytes = (ring_bytes / 2).max(min);
                }
                (Err(error), _) => return Err(error),
            }
        }
    }

    /// Reserves a piece of at most `bytes` bytes: the ring's buffer and a range of it that nothing in flight uses.
    pub(super) fn reserve(&mut self, device: &Arc<Device>, bytes: u64) -> Result<(Buffer, Range<u64>)> {
        let ring = self.buffer(device, bytes)?;
        let max = ring.bytes() / PIECES / PLACEMENT_ALIGNMENT * PLACEMENT_ALIGNMENT;
        let length = bytes.min(max);
        let first = if self.head + length > ring.bytes() { 0 } else { self.head };
        let place = first..first + length;
        let overlaps = |piece: &Piece| piece.bytes.start < place.end && place.start < piece.bytes.end;
        while self.running.iter().any(overlaps) {
            self.wait_oldest(device)?;
        }
        Ok((ring, place))
    }

    /// Copies bytes to the start of a buffer, as many as fit a piece, and returns their number. The copy runs after all
    /// earlier submissions if `after_work`, otherwise beside them.
    pub(super) fn copy(
        &mut self,
        pools: &Arc<Pools>,
        to: &Buffer,
        bytes: &[u8],
        after_work: bool,
    ) -> Result<usize> {
        let device = &pools.device;
        let (ring, place) = self.reserve(device, bytes.len() as u64)?;
        let length = place.end - place.start;
        ring.block().write_mapped(ring.offset() + place.start, &bytes[..length as usize]);
        // The last piece may end within a word: the rest of that word is in the buffer's padding.
        let to = to.range(0, length.next_multiple_of(4).min(to.bytes()));
        let queue = device.copying.as_ref();
        let mut commands = Commands::begin(pools, queue, "upload", 0)?;
        ring.range(place.start, to.bytes()).record_copy(commands.raw(), &to);
        if let Some(queue) = queue {
            let (stage, access) = (vk::PipelineStageFlags2::COPY, vk::AccessFlags2::TRANSFER_WRITE);
            let released = owner_change(queue, device, &to);
            commands.buffer_barrier(released.src_stage_mask(stage).src_access_mask(access));
        }
        let after = queue.filter(|_| after_work).map(|queue| queue.worked.last());
        commands.submit(after)?;
        self.head = place.end.next_multiple_of(PLACEMENT_ALIGNMENT);
        self.released.extend(queue.map(|_| to.clone()));
        self.running.push_back(Piece { commands, bytes: place, _kept: vec![ring, to] });
        Ok(length as usize)
    }

    /// Makes the main queue acquire the data that the copy queue has written. Submissions after this one wait for the
    /// copies and see the data. The host does not wait.
    pub(super) fn take_over(&mut self, pools: &Arc<Pools>) -> Result<()> {
        let device = &pools.device;
        let Some(queue) = device.copying.as_ref().filter(|_| !self.released.is_empty()) else {
            return Ok(());
        };
        let mut commands = Commands::begin(pools, None, "take over uploads", 0)?;
        for to in &self.released {
            // Uses the stages in which the submission waits for the semaphore.
            let acquire = owner_change(queue, device, to)
                .src_stage_mask(vk::PipelineStageFlags2::ALL_COMMANDS)
                .dst_stage_mask(vk::PipelineStageFlags2::ALL_COMMANDS)
                .dst_access_mask(vk::AccessFlags2::MEMORY_READ | vk::AccessFlags2::MEMORY_WRITE);
            commands.buffer_barrier(acquire);
        }
        commands.submit(Some(queue.copied.last()))?;
        // Cleared only after success, so that a second attempt acquires the same buffers.
        let released = std::mem::take(&mut self.released);
        self.running.push_back(Piece { commands, bytes: 0..0, _kept: released });
        Ok(())
    }

    /// Forgets the copies into a buffer after a failed upload.
    pub(super) fn forget(&mut self, to: &Buffer) {
        let end = to.offset() + to.bytes();
        self.released.retain(|of| of.raw() != to.raw() || of.offset() < to.offset() || of.offset() >= end);
    }

    /// Leaves the buffer to a failed submission that may still run; the next transfer allocates another one.
    pub(super) fn abandon(&mut self) {
        self.buffer = None;
        self.head = 0;
    }

    /// Waits for the oldest submission. An error leaves it in the ring: it may still run.
    fn wait_oldest(&mut self, device: &Device) -> Result<()> {
        let Some(piece) = self.running.front_mut() else { return Ok(()) };
        piece.commands.wait(device.timeout)?;
        self.running.pop_front();
        Ok(())
    }

    pub(super) fn settle(&mut self, device: &Device) -> Result<()> {
        while !self.running.is_empty() {
            self.wait_oldest(device)?;
        }
        Ok(())
    }

    pub(super) fn bytes(&self) -> u64 {
        self.buffer.as_ref().map_or(0, Buffer::bytes)
    }

    /// Forgets copies into memory that nothing else owns any more, after a failed upload. Nothing is in flight. Returns
    /// true if there were any.
    fn forget_dropped(&mut self) -> bool {
        let is_held = |of: &&Buffer| {
            let own = self.released.iter().filter(|other| Arc::ptr_eq(other.block(), of.block())).count();
            Arc::strong_count(of.block()) > own
        };
        // A copied `Buffer` counts as an owner only of memory that has another owner.
        let held: Vec<Buffer> = self.released.iter().filter(is_held).cloned().collect();
        let all = std::mem::replace(&mut self.released, held);
        self.released.len() < all.len()
    }

    /// Frees the ring's memory, after its submissions. Returns true if there was any.
    pub(super) fn free(&mut self) -> bool {
        // Dropping them waits for them.
        self.running.clear();
        let forgotten = self.forget_dropped();
        self.head = 0;
        self.buffer.take().is_some() || forgotten
    }
}

fn max_ring_bytes(device: &Device) -> u64 {
    device.limits.max_storage_buffer_range.min(device.limits.max_allocation_bytes)
}

fn min_ring_bytes(device: &Device) -> u64 {
    MIN_RING_BYTES.min(max_ring_bytes(device) / 2)
}

pub(super) fn min_room(device: &Device) -> u64 {
    device.allocation_bytes(&[("ring", min_ring_bytes(device))], &[])
}

/// Returns the common part of both barriers of an ownership transfer, from the copy queue to the main queue.
fn owner_change(queue: &CopyQueue, device: &Device, to: &Buffer) -> vk::BufferMemoryBarrier2<'static> {
    vk::BufferMemoryBarrier2::default()
        .src_queue_family_index(queue.family)
        .dst_queue_family_index(device.queue_family)
        .buffer(to.raw())
        .offset(to.offset())
        .size(to.bytes())
}
