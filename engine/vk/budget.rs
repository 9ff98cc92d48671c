//! Allocates memory in a context, reports how much exists and is allowed, and measures its rates.

use super::context::Context;
use super::lock::lock;
#[cfg(feature = "testing")]
use super::memory::GUARD_BYTES;
use super::memory::{Block, Buffer, Life, MAX_MEMORY, UNBOUNDED};
use super::memory_types::{ArenaMemory, MemoryKind};
use super::recorder::Recorder;
use super::staging;
use crate::error::{Error, Result};
use ash::vk;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Instant;

impl Context {
    /// Allocates buffers of one lifetime. Messages name each as `arena.request`.
    ///
    /// The requests (name, bytes) are packed into as few blocks as the device allows. Every buffer has at least 16
    /// bytes and a multiple of 4, and begins at a multiple of 256. The contents are undefined.
    ///
    /// # Errors
    /// [`crate::Error::TooLarge`] for a request above maxStorageBufferRange or the largest allocation. Also if all requests
    /// together exceed the memory of a GPU or [`super::ContextOptions::max_memory`]. If the host does not see device
    /// memory, 256 KiB of that bound remain for transfers. Nothing is allocated in these cases.
    /// [`crate::Error::Vulkan`] when the device has no memory left.
    pub fn allocate(
        &self,
        arena: &'static str,
        requests: &[(&'static str, u64)],
        kind: MemoryKind,
    ) -> Result<Vec<Buffer>> {
        self.allocate_shared(arena, requests, &[], kind)
    }

    /// Same as [`Context::allocate`], but buffers share memory if their `lives`, one per request, have no step in common.
    /// Requests without an entry share none.
    pub fn allocate_shared(
        &self,
        arena: &'static str,
        requests: &[(&'static str, u64)],
        lives: &[Life],
        kind: MemoryKind,
    ) -> Result<Vec<Buffer>> {
        let allocate = || self.device.allocate(arena, requests, lives, kind, self.staging_reserve(kind));
        let buffers = match allocate() {
            Err(Error::TooLarge { .. }) if self.free_staging() => allocate()?,
            allocated => allocated?,
        };
        self.clear_if_audited(&buffers, kind)?;
        #[cfg(feature = "testing")]
        self.raise_guards(&buffers)?;
        Ok(buffers)
    }

    /// Returns the bytes of the memory limit that this allocation must leave free for a staging ring.
    fn staging_reserve(&self, kind: MemoryKind) -> u64 {
        // A running download holds the ring's lock.
        if self.max_memory().is_none() || kind == MemoryKind::Offloaded || lock(&self.staging).bytes() > 0 {
            return 0;
        }
        self.min_ring()
    }

    /// Returns the fewest bytes of the staging ring; 0 without a ring.
    pub(crate) fn min_ring(&self) -> u64 {
        if self.device.reads_mapped() { 0 } else { staging::min_room(&self.device) }
    }

    /// Frees the staging memory kept for later transfers, if device memory is not mapped. Waits for uploads in flight.
    /// Returns true if there was any. Allocations that would not fit call this themselves.
    pub fn free_staging(&self) -> bool {
        lock(&self.staging).free()
    }

    /// Bytes of all arenas, for planning further allocations. The staging ring counts with its smallest size, because it
    /// can shrink to it. So a plan does not depend on earlier transfers.
    pub(crate) fn held_bytes(&self) -> u64 {
        let ring = lock(&self.staging).bytes();
        self.memory_total().bytes.saturating_sub(ring) + self.min_ring()
    }

    /// Returns the bytes that [`Context::allocate`] takes for these requests. If it would refuse them, returns their sum.
    pub(crate) fn allocation_bytes(&self, requests: &[(&'static str, u64)]) -> u64 {
        self.shared_bytes(requests, &[])
    }

    /// Returns the bytes that [`Context::allocate_shared`] takes. If it would refuse the requests, returns their sum.
    pub(crate) fn shared_bytes(&self, requests: &[(&'static str, u64)], lives: &[Life]) -> u64 {
        self.device.allocation_bytes(requests, lives)
    }

    fn clear_if_audited(&self, buffers: &[Buffer], kind: MemoryKind) -> Result<()> {
        if !self.is_audited() || kind == MemoryKind::HostVisible {
            return Ok(());
        }
        // Buffers may share memory.
        let mut blocks: Vec<Buffer> = buffers.iter().map(Buffer::whole).collect();
        blocks.sort_by_key(Buffer::memory_id);
        blocks.dedup_by_key(|block| block.memory_id());
        let clear = |recorder: &mut Recorder| blocks.iter().for_each(|block| recorder.fill(block, 0));
        self.run("clear", clear).map(drop)
    }

    /// Resets the peaks of [`Context::memory`] and [`Context::memory_total`] to the current bytes, and forgets empty
    /// arenas. Lets one context measure several pieces of work.
    pub fn reset_memory_peaks(&self) {
        self.device.registry.reset_peaks();
    }

    /// Returns current and peak bytes of each arena. The peak counts from [`Context::reset_memory_peaks`] on.
    pub fn memory(&self) -> Vec<ArenaMemory> {
        self.device.registry.all()
    }

    /// Returns current and peak bytes of all arenas together, without [offloaded](Context::memory_offloaded) memory (peak
    /// as in [`Context::memory`]).
    pub fn memory_total(&self) -> ArenaMemory {
        self.device.registry.total()
    }

    /// Returns the most bytes that all arenas together may have allocated at a time, and the limit's name. It is the
    /// smallest of [`super::ContextOptions::max_memory`], the driver's current budget (VK_EXT_memory_budget) and a GPU's
    /// largest device-local heap. None: unknown.
    pub fn memory_limit(&self) -> Option<(u64, &'static str)> {
        let limits = self.limits();
        let heap = limits.tuning.heap_is_bound.then_some((limits.heap_bytes, "device-local heap"));
        let requested = self.max_memory().map(|bytes| (bytes, MAX_MEMORY));
        let driver = self.driver_budget().map(|bytes| (bytes, "VK_EXT_memory_budget"));
        [requested, driver, heap].into_iter().flatten().min_by_key(|(bytes, _)| *bytes)
    }

    /// Returns [`super::ContextOptions::max_memory`], or the value that [`Context::set_max_memory`] set.
    pub fn max_memory(&self) -> Option<u64> {
        self.device.max_memory()
    }

    /// Changes [`super::ContextOptions::max_memory`], for a host whose own need changes. Existing allocations stay, even
    /// above the bound; later ones must fit below it. Call it between pieces of work: a trainer whose bound changes grows
    /// differently, so its results have other bits.
    pub fn set_max_memory(&self, bytes: Option<u64>) {
        self.device.max_memory.store(bytes.unwrap_or(UNBOUNDED), Ordering::Relaxed);
    }

    /// Returns [`super::ContextOptions::offload`], or the value that [`Context::set_offload`] set.
    pub fn offload(&self) -> Option<u64> {
        self.device.offload()
    }

    /// Changes [`super::ContextOptions::offload`] for trainers made later.
    pub fn set_offload(&self, bytes: Option<u64>) {
        self.device.offload.store(bytes.unwrap_or(0), Ordering::Relaxed);
    }

    /// Returns the memory kind of per-Gaussian data that a step needs for only a few Gaussians.
    pub(crate) fn planes_memory(&self) -> MemoryKind {
        self.offload().map_or(MemoryKind::Device, |_| MemoryKind::Offloaded)
    }

    /// Returns current and peak bytes of offloaded memory, which [`Context::memory_total`] excludes (peak as in
    /// [`Context::memory`]).
    pub fn memory_offloaded(&self) -> ArenaMemory {
        self.device.registry.offloaded()
    }

    /// Returns the driver's budget for this context in the largest device-local heap, including its current bytes.
    fn driver_budget(&self) -> Option<u64> {
        let physical = self.device.budget?;
        let mut budget = vk::PhysicalDeviceMemoryBudgetPropertiesEXT::default();
        let mut properties = vk::PhysicalDeviceMemoryProperties2::default().push_next(&mut budget);
        // SAFETY: a query on a physical device of this instance, which has the extension.
        unsafe {
            let instance = self.device.owner.instance();
            instance.get_physical_device_memory_properties2(physical, &mut properties);
        }
        let heaps = self.device.memory.memory_heaps_as_slice().iter().enumerate();
        let local = heaps.filter(|(_, heap)| heap.flags.contains(vk::MemoryHeapFlags::DEVICE_LOCAL));
        let (largest, _) = local.max_by_key(|(_, heap)| heap.size)?;
        // Others in this process, such as a host's engine, may use the heap too: the share is the free part and our bytes.
        let free = budget.heap_budget[largest].saturating_sub(budget.heap_usage[largest]);
        Some(free.saturating_add(self.memory_total().bytes))
    }
}

/// For tests: content of the guard bands around every buffer, which detect writes outside it.
#[cfg(feature = "testing")]
const GUARD_PATTERN: u8 = 0xA5;

#[cfg(feature = "testing")]
fn guards(buffer: &Buffer) -> [Buffer; 2] {
    let band = |offset| Buffer::new(buffer.block().clone(), offset, GUARD_BYTES, buffer.name());
    [buffer.offset() - GUARD_BYTES, buffer.offset() + buffer.bytes()].map(band)
}

#[cfg(feature = "testing")]
impl Context {
    /// Fills the guard bands of new buffers with their pattern, if there are any.
    fn raise_guards(&self, buffers: &[Buffer]) -> Result<()> {
        if !self.device.guard_bands {
            return Ok(());
        }
        for band in buffers.iter().flat_map(guards) {
            self.upload(&band, &[GUARD_PATTERN; GUARD_BYTES as usize])?;
        }
        let mut blocks = lock(&self.logs.guarded);
        blocks.retain(|block| block.strong_count() > 0);
        for buffer in buffers {
            let mut guarded = lock(&buffer.block().guarded);
            if guarded.is_empty() {
                blocks.push(Arc::downgrade(buffer.block()));
            }
            guarded.push((buffer.offset(), buffer.bytes(), buffer.name()));
        }
        Ok(())
    }

    /// Returns the names of living buffers with writes outside them; see [`super::ContextOptions::guard_bands`].
    pub fn breached_guards(&self) -> Result<Vec<&'static str>> {
        let blocks = lock(&self.logs.guarded).clone();
        let mut breached = Vec::new();
        for block in blocks.iter().filter_map(std::sync::Weak::upgrade) {
            let guarded = lock(&block.guarded).clone();
            for (offset, bytes, name) in guarded {
                for band in guards(&Buffer::new(block.clone(), offset, bytes, name)) {
                    if self.download(&band)?.iter().any(|&byte| byte != GUARD_PATTERN) {
                        breached.push(name);
                    }
                }
            }
        }
        Ok(breached)
    }
}

const ROUNDS: usize = 3;
/// Most bytes that the host reads: without a cache it reads a few MB per millisecond at best.
const MAX_READ: u64 = 8 << 20;

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
            writes_directly: self.device.location.is_mapped(),
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
        let (arena, kind) = ("measurement", MemoryKind::HostVisible);
        match Block::new(&self.device, (arena, 0), bytes, kind, 1 << index) {
            Ok(block) => Ok(Some(Buffer::new(Arc::new(block), 0, bytes, "host"))),
            Err(error @ Error::DeviceLost { .. }) => Err(error),
            Err(_) => Ok(None),
        }
    }

    fn copy_rate(&self, from: &Buffer, to: &Buffer) -> Result<f64> {
        let mut best = f64::INFINITY;
        for _ in 0..ROUNDS {
            let begin = Instant::now();
            let report = self.run("measurement", |recorder| recorder.copy(from, to))?;
            let waited = begin.elapsed().as_secs_f64();
            best = best.min(if report.nanoseconds > 0.0 { report.nanoseconds * 1e-9 } else { waited });
        }
        Ok(from.bytes() as f64 / best.max(1e-9))
    }
}

fn host_rates(buffer: &Buffer) -> (f64, f64) {
    let written = vec![0x5A; buffer.bytes() as usize];
    let mut back = vec![0; buffer.bytes().min(MAX_READ) as usize];
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
