//! The guest's memory from the host's allocator: an adapter for the crate `gpu-allocator`, made to be copied.

use super::host::{Host, Result};
use ashsplat::vk::{HostAllocator, HostMemory, MemoryKind, MemoryRequest};
use gpu_allocator::MemoryLocation;
use gpu_allocator::vulkan::{
    Allocation, AllocationCreateDesc, AllocationScheme, Allocator, AllocatorCreateDesc,
};
use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};

/// The adapter. Must be dropped before the device, after everything that uses its memory.
pub struct Adapter(Mutex<Live>);

struct Live {
    allocator: Allocator,
    pieces: HashMap<u64, Allocation>,
    next: u64,
}

impl Adapter {
    pub fn new(host: &Host) -> Result<Self> {
        let description = AllocatorCreateDesc {
            instance: host.instance.clone(),
            device: host.device.clone(),
            physical_device: host.physical,
            debug_settings: Default::default(),
            buffer_device_address: false,
            allocation_sizes: Default::default(),
        };
        let allocator = Allocator::new(&description)?;
        Ok(Self(Mutex::new(Live { allocator, pieces: HashMap::new(), next: 0 })))
    }

    pub fn pieces(&self) -> usize {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).pieces.len()
    }
}

// SAFETY: gpu-allocator returns memory as requested, exclusive until it is freed, and maps only coherent
// memory.
unsafe impl HostAllocator for Adapter {
    fn allocate(&self, request: &MemoryRequest<'_>) -> std::result::Result<HostMemory, String> {
        let mut live = self.0.lock().map_err(|e| e.to_string())?;
        let description = AllocationCreateDesc {
            name: request.name,
            requirements: request.requirements,
            location: match request.kind {
                MemoryKind::Device => MemoryLocation::GpuOnly,
                MemoryKind::HostVisible | MemoryKind::Offloaded => MemoryLocation::GpuToCpu,
            },
            linear: true,
            allocation_scheme: AllocationScheme::GpuAllocatorManaged,
        };
        let piece = live.allocator.allocate(&description).map_err(|e| e.to_string())?;
        let id = live.next;
        live.next += 1;
        // SAFETY: the memory object is only bound, and only while the piece is allocated.
        let memory = unsafe { piece.memory() };
        let memory =
            HostMemory { memory, offset: piece.offset(), mapped: piece.mapped_ptr().map(|p| p.cast()), id };
        live.pieces.insert(id, piece);
        Ok(memory)
    }

    fn free(&self, memory: HostMemory) {
        if let Ok(mut live) = self.0.lock()
            && let Some(piece) = live.pieces.remove(&memory.id)
        {
            let _ = live.allocator.free(piece);
        }
    }
}
