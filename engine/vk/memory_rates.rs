//! How fast the host writes and reads each kind of memory, and how fast the device copies to and from it.

use super::allocator::MemoryKind;
use super::buffer::Buffer;
use super::context::Context;
use super::memory::Block;
use crate::{Error, Result};
use ash::vk;
use std::sync::Arc;
use std::time::Instant;

/// Of each rate the best of so many is taken.
const ROUNDS: usize = 3;
/// Most bytes that the host reads: without a cache it reads a few MB a millisecond at best.
const MOST_READ: u64 = 8 << 20;

/// What [`Context::measure_memory`] found of a memory type that the host sees. Rates in bytes per second.
#[derive(Clone, Copy, Debug)]
#[non_exhaustive]
pub struct MemoryRates {
    /// Its index.
    pub memory_type: u32,
    /// Whether it is the device's own (of a card: seen through the bus).
    pub device_local: bool,
    /// Whether the host reads it through its caches.
    pub cached: bool,
    /// Whether arenas of the device lie in it: uploads then write it directly.
    pub holds_arenas: bool,
    /// Size of its heap.
    pub heap_bytes: u64,
    /// The host writes.
    pub write: f64,
    /// The host reads.
    pub read: f64,
    /// The device copies from it into its own memory.
    pub to_device: f64,
    /// The device copies from its own memory into it.
    pub from_device: f64,
}

/// How contents come into the device's memory and back, by its memory types and queues.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Transfers {
    /// Uploads are written into the device's memory itself: it is the host's, or the host sees all of it (resizable BAR).
    /// Otherwise they are copied from a ring of staging memory.
    pub writes_directly: bool,
    /// Downloads are read from the device's memory itself: it is the host's, and cached. Otherwise they are copied first.
    pub reads_directly: bool,
    /// Staged uploads are copied by a queue of their own, beside the main queue's work. So are photographs that training reads from a
    /// file, unless the device's memory is the host's.
    pub copy_queue: bool,
}

impl Context {
    /// How contents come into the device's memory and back.
    pub fn transfers(&self) -> Transfers {
        Transfers {
            writes_directly: self.device.place.is_mapped(),
            reads_directly: self.device.reads_mapped(),
            copy_queue: self.device.copying.is_some(),
        }
    }

    /// Measures every memory type that the host sees, with buffers of this many bytes. A type whose heap has no room is left out.
    ///
    /// # Errors
    /// [`Error::Argument`] for no bytes, as [`Context::allocate`] and [`Context::run`].
    pub fn measure_memory(&self, bytes: u64) -> Result<Vec<MemoryRates>> {
        if bytes == 0 {
            return Err(Error::argument("bytes", "a measurement needs some"));
        }
        let device = self.allocate("measurement", &[("device", bytes)], MemoryKind::Device)?.swap_remove(0);
        let memory = &self.device.memory;
        let own = self.device.memory_type(u32::MAX, MemoryKind::Device)?;
        let mut all = Vec::new();
        for (index, of) in memory.memory_types_as_slice().iter().enumerate() {
            type Flags = vk::MemoryPropertyFlags;
            let (flags, index) = (of.property_flags, index as u32);
            // The same rule as for memory that is used.
            let Ok(found) = self.device.memory_type(1 << index, MemoryKind::HostVisible) else { continue };
            let Some(host) = self.of_type(found, device.bytes())? else { continue };
            let (write, read) = host_rates(&host);
            all.push(MemoryRates {
                memory_type: index,
                device_local: flags.contains(Flags::DEVICE_LOCAL),
                cached: flags.contains(Flags::HOST_CACHED),
                holds_arenas: index == own,
                heap_bytes: memory.memory_heaps_as_slice()[of.heap_index as usize].size,
                write,
                read,
                to_device: self.copy_rate(&host, &device)?,
                from_device: self.copy_rate(&device, &host)?,
            });
        }
        Ok(all)
    }

    /// A buffer in a memory type; None where it does not fit or no buffer may lie there.
    fn of_type(&self, index: u32, bytes: u64) -> Result<Option<Buffer>> {
        let kind = MemoryKind::HostVisible;
        let block = Block::of_types(&self.device, (&"measurement".into(), 0), bytes, kind, 1 << index);
        match block {
            Ok(block) => Ok(Some(Buffer::new(Arc::new(block), 0, bytes, "host"))),
            Err(error @ Error::DeviceLost { .. }) => Err(error),
            Err(_) => Ok(None),
        }
    }

    fn copy_rate(&self, from: &Buffer, to: &Buffer) -> Result<f64> {
        let mut best = f64::INFINITY;
        for _ in 0..ROUNDS {
            let begin = Instant::now();
            let report = self.run("measurement", |recorder| {
                recorder.copy(from, to);
                Ok(())
            })?;
            let waited = begin.elapsed().as_secs_f64();
            let seconds = if report.nanoseconds > 0.0 { report.nanoseconds * 1e-9 } else { waited };
            best = best.min(seconds);
        }
        Ok(from.bytes() as f64 / best.max(1e-9))
    }
}

/// Bytes per second that the host writes and reads.
fn host_rates(buffer: &Buffer) -> (f64, f64) {
    let written = vec![0x5A; buffer.bytes() as usize];
    let mut back = vec![0; buffer.bytes().min(MOST_READ) as usize];
    let timed = |work: &mut dyn FnMut()| {
        let begin = Instant::now();
        work();
        begin.elapsed().as_secs_f64()
    };
    let (mut write, mut read) = (f64::INFINITY, f64::INFINITY);
    for _ in 0..ROUNDS {
        write = write.min(timed(&mut || _ = buffer.block().write_mapped(buffer.offset(), &written)));
        read = read.min(timed(&mut || _ = buffer.block().read_mapped(buffer.offset(), &mut back)));
    }
    // What was read is looked at, so that it is read.
    assert!(back.iter().all(|&byte| byte == 0x5A), "memory does not hold what was written");
    (written.len() as f64 / write.max(1e-9), back.len() as f64 / read.max(1e-9))
}
