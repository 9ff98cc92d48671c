//! Allocates memory: packs requests into blocks and checks the limits.

use super::allocator::MemoryKind;
use super::buffer::Buffer;
#[cfg(feature = "testing")]
use super::guard_bands::GUARD_BYTES;
use super::memory::{Block, SMALLEST_BUFFER, pack};
use super::open_device::Device;
use crate::{Error, Result};
use std::sync::Arc;
use std::sync::atomic::Ordering;

/// Setting that messages name for [`ContextOptions::max_memory`](super::ContextOptions::max_memory).
pub(super) const MAX_MEMORY: &str = "--max-memory";

/// Setting that messages name for [`ContextOptions::offload`](super::ContextOptions::offload).
pub(super) const OFFLOAD: &str = "--offload";

/// Value of the bound when memory is unbounded.
pub(super) const UNBOUNDED: u64 = u64::MAX;

impl Device {
    /// Bytes of each guard band.
    #[cfg(not(feature = "testing"))]
    fn guard(&self) -> u64 {
        0
    }

    /// Bytes of each guard band.
    #[cfg(feature = "testing")]
    fn guard(&self) -> u64 {
        if self.guard_bands { GUARD_BYTES } else { 0 }
    }

    /// Returns the bytes of each buffer with its guard bands.
    fn sizes(&self, requests: &[(&'static str, u64)]) -> Vec<u64> {
        let guarded = |bytes: u64| bytes.max(SMALLEST_BUFFER).next_multiple_of(4) + 2 * self.guard();
        requests.iter().map(|(_, bytes)| guarded(*bytes)).collect()
    }

    /// Returns the bytes that [`Device::allocate`] takes for these requests. If it would refuse them, returns their sum.
    pub(super) fn allocation_bytes(&self, requests: &[(&'static str, u64)]) -> u64 {
        let sizes = self.sizes(requests);
        let blocks = pack(&sizes, self.limits.max_allocation_bytes).map_or(sizes, |packing| packing.blocks);
        blocks.iter().sum()
    }

    /// Same as [`Context::max_memory`](super::Context::max_memory).
    pub(super) fn max_memory(&self) -> Option<u64> {
        Some(self.max_memory.load(Ordering::Relaxed)).filter(|&bytes| bytes != UNBOUNDED)
    }

    /// Same as [`Context::offload`](super::Context::offload).
    pub(super) fn offload(&self) -> Option<u64> {
        Some(self.offload.load(Ordering::Relaxed)).filter(|&bytes| bytes > 0)
    }

    /// Same as [`Context::allocate`](super::Context::allocate), but without guard bands' contents and audits. `kept_free`:
    /// bytes below the bound that remain for the next transfer.
    pub(super) fn allocate(
        self: &Arc<Self>,
        arena: &str,
        requests: &[(&'static str, u64)],
        kind: MemoryKind,
        kept_free: u64,
    ) -> Result<Vec<Buffer>> {
        let limits = &self.limits;
        let too_large = |what: String, needed, limit, limit_name| {
            Err(Error::TooLarge { what, needed, unit: "bytes", limit, limit_name })
        };
        if let Some(&(name, bytes)) = requests.iter().find(|(_, b)| *b > limits.max_storage_buffer_range) {
            let limit = limits.max_storage_buffer_range;
            return too_large(format!("buffer {arena}.{name}"), bytes, limit, "maxStorageBufferRange");
        }
        let guard = self.guard();
        let sizes = self.sizes(requests);
        let packing = match pack(&sizes, limits.max_allocation_bytes) {
            Ok(packing) => packing,
            Err(i) => {
                let limit = limits.max_allocation_bytes;
                let what = format!("buffer {arena}.{}", requests[i].0);
                return too_large(what, sizes[i], limit, "maxMemoryAllocationSize");
            }
        };
        let total: u64 = packing.blocks.iter().sum();
        if total > limits.heap_bytes && kind == MemoryKind::Device && limits.tuning.heap_is_bound {
            return too_large(format!("arena {arena}"), total, limits.heap_bytes, "device-local heap");
        }
        let (used, limit, limit_name) = match kind {
            MemoryKind::Offloaded => (self.registry.offloaded().bytes, self.offload(), OFFLOAD),
            _ => (self.registry.total().bytes + kept_free, self.max_memory(), MAX_MEMORY),
        };
        if let Some(limit) = limit.filter(|&limit| used.saturating_add(total) > limit) {
            let what = match kept_free {
                0 => format!("arena {arena} (beside {used} bytes in use)"),
                _ => format!("arena {arena} (beside {used} bytes in use and for transfers)"),
            };
            return too_large(what, used.saturating_add(total), limit, limit_name);
        }
        let arena: Arc<str> = arena.into();
        let blocks = (packing.blocks.iter().enumerate())
            .map(|(number, &bytes)| Ok(Arc::new(Block::new(self, &arena, number, bytes, kind)?)))
            .collect::<Result<Vec<_>>>()?;
        let places = requests.iter().zip(&packing.places);
        let buffers = places.map(|(&(name, bytes), &(block, offset))| {
            let bytes = bytes.max(SMALLEST_BUFFER).next_multiple_of(4);
            Buffer::new(blocks[block].clone(), offset + guard, bytes, name)
        });
        Ok(buffers.collect())
    }
}
