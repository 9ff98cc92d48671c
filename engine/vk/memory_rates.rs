//! Measures how fast the host writes and reads each kind of memory, and how fast the device copies to and from it.

use super::allocator::MemoryKind;
use super::buffer::Buffer;
use super::context::Context;
use super::memory::Block;
use crate::{Error, Result};
use ash::vk;
use std::sync::Arc;
use std::time::Instant;

/// Number of measurements per rate; the best one counts.
const ROUNDS: usize = 3;
/// Most bytes that the host reads: without a cache it reads a few MB per millisecond at best.
const MOST_READ: u64 = 8 << 20;

/// Rates of a host-visible memory type, from [`Context::measure_memory`]. Bytes per second.
#[derive(Clone, Copy, Debug)]
#[non_exhaustive]
pub struct MemoryRates {
    /// Index of the memory type.
    pub memory_type: u32,
    /// True if it is device-local (for a card: seen over the bus).
    pub device_local: bool,
    /// True if the host reads it through its caches.
    pub cached: bool,
    /// True if the device's arenas are in it: uploads then write it directly.
    pub holds_arenas: bool,
    /// Bytes of its heap.
    pub heap_bytes: u64,
    /// Rate of host writes.
    pub write: f64,
    /// Rate of host reads.
    pub read: f64,
    /// Rate of device copies from it into device memory.
    pub to_device: f64,
    /// Rate of device copies from device memory into it.
    pub from_device: f64,
}

/// Paths of uploads and downloads, by the device's memory types and queues.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Transfers {
    /// True if uploads write device memory directly: it is host memory, or the host sees all of it (resizable BAR).
    /// Otherwise they are copied from a ring of staging memory.
    pub writes_directly: bool,
    /// True if downloads read device memory directly: it is host memory, and cached. Otherwise they are copied first.
    pub reads_directly: bool,
    /// True if a separate queue copies staged uploads, beside the main queue's work. It also copies photographs that
    /// training reads from a file, unless device memory is host memory.
    pub copy_queue: bool,
}

impl Context {
    /// Returns the paths of uploads and downloads.
    pub fn transfers(&self) -> Transfers {
        Transfers {
            writes_directly: self.device.place.is_mapped(),
            reads_directly: self.device.reads_mapped(),
            copy_queue: self.device.copying.is_some(),
        }
    }

    /// Measures every host-visible memory type, with buffers of this many bytes. Omits a type whose heap is too full.
    ///
    /// # Errors
    /// [`Error::Argument`] for no bytes. Same as [`Context::allocate`] and [`Context::run`].
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
            // Same rule as for memory in use.
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

    /// Allocates a buffer in a memory type. None if it does not fit, or no buffer may use this type.
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

/// Measures the bytes per second that the host writes and reads.
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
    // Uses the result, so that the reads are not optimized away.
    assert!(back.iter().all(|&byte| byte == 0x5A), "memory does not hold what was written");
    (written.len() as f64 / write.max(1e-9), back.len() as f64 / read.max(1e-9))
}
