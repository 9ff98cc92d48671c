//! Allocates memory in a context, and reports how much exists and is allowed.

use super::allocate::{MAX_MEMORY, UNBOUNDED};
use super::allocator::MemoryKind;
use super::arenas::ArenaMemory;
use super::buffer::Buffer;
use super::context::Context;
use super::staging;
use crate::{Error, Result};
use ash::vk;
use std::sync::PoisonError;
use std::sync::atomic::Ordering;

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
        arena: &str,
        requests: &[(&'static str, u64)],
        kind: MemoryKind,
    ) -> Result<Vec<Buffer>> {
        let mut allocated = self.device.allocate(arena, requests, kind, self.room_of_transfers(kind));
        if matches!(allocated, Err(Error::TooLarge { .. })) && self.free_staging() {
            allocated = self.device.allocate(arena, requests, kind, self.room_of_transfers(kind));
        }
        let buffers = allocated?;
        #[cfg(feature = "testing")]
        self.raise_guards(&buffers)?;
        self.clear_if_audited(&buffers, kind)?;
        Ok(buffers)
    }

    /// Returns the bytes of bounded memory that an allocation leaves free for the next transfer.
    fn room_of_transfers(&self, kind: MemoryKind) -> u64 {
        // A running download holds the ring's lock.
        if self.max_memory().is_none() || kind == MemoryKind::Offloaded || self.staging.lock().bytes() > 0 {
            return 0;
        }
        self.least_ring()
    }

    /// Returns the fewest bytes of the staging ring; 0 without a ring.
    pub(crate) fn least_ring(&self) -> u64 {
        if self.device.reads_mapped() { 0 } else { staging::least_room(&self.device) }
    }

    /// Frees the staging memory kept for later transfers, if device memory is not mapped. Waits for uploads in flight.
    /// Returns true if there was any. Allocations that would not fit call this themselves.
    pub fn free_staging(&self) -> bool {
        self.staging.lock().free()
    }

    /// Bytes of all arenas, for planning further allocations. The staging ring counts with its smallest size, because it
    /// can shrink to it. So a plan does not depend on earlier transfers.
    pub(crate) fn held_bytes(&self) -> u64 {
        let ring = self.staging.lock().bytes();
        self.memory_total().bytes.saturating_sub(ring) + self.least_ring()
    }

    /// Returns the bytes that [`Context::allocate`] takes for these requests. If it would refuse them, returns their sum.
    pub(crate) fn allocation_bytes(&self, requests: &[(&'static str, u64)]) -> u64 {
        self.device.allocation_bytes(requests)
    }

    /// Clears new memory if an audit exists.
    fn clear_if_audited(&self, buffers: &[Buffer], kind: MemoryKind) -> Result<()> {
        let audited = self.logs.audit.lock().unwrap_or_else(PoisonError::into_inner).strong_count() > 0;
        if !audited || kind == MemoryKind::HostVisible {
            return Ok(());
        }
        self.run("clear", |recorder| {
            buffers.iter().for_each(|buffer| recorder.fill(buffer, 0));
            Ok(())
        })?;
        Ok(())
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
        let heap =
            self.limits().tuning.heap_is_bound.then_some((self.limits().heap_bytes, "device-local heap"));
        let asked = self.max_memory().map(|bytes| (bytes, MAX_MEMORY));
        let driver = self.driver_budget().map(|bytes| (bytes, "VK_EXT_memory_budget"));
        [asked, driver, heap].into_iter().flatten().min_by_key(|(bytes, _)| *bytes)
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
        Some(of_driver(budget.heap_budget[largest], budget.heap_usage[largest], self.memory_total().bytes))
    }
}

/// Returns this context's share of a heap: its own bytes, and the free part of the budget. Other users in this process,
/// such as a host's engine, may use the heap too.
fn of_driver(heap_budget: u64, heap_usage: u64, ours: u64) -> u64 {
    heap_budget.saturating_sub(heap_usage).saturating_add(ours)
}

#[cfg(test)]
mod tests {
    use super::of_driver;

    #[test]
    fn what_others_use_is_not_ours() {
        // No other user.
        assert_eq!(of_driver(1000, 300, 300), 1000);
        assert_eq!(of_driver(1000, 0, 0), 1000);
        // Another user has 500.
        assert_eq!(of_driver(1000, 800, 300), 500);
        // Over the budget already: nothing can be added, and the current bytes stay.
        assert_eq!(of_driver(1000, 1200, 300), 300);
        // A part of our bytes lies in another heap.
        assert_eq!(of_driver(1000, 200, 300), 1100);
        assert_eq!(of_driver(u64::MAX, 0, 9), u64::MAX);
    }
}
