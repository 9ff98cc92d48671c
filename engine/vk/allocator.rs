//! Device memory from a host's own allocator.

use super::memory::MemoryKind;
use ash::vk;
use std::ptr::NonNull;

/// What is to be allocated.
#[derive(Clone, Copy, Debug)]
pub struct MemoryRequest<'a> {
    /// What it is for, for debugging.
    pub name: &'a str,
    /// Size, alignment and the memory types that will do, for a buffer.
    pub requirements: vk::MemoryRequirements,
    /// What the memory is used for: [`MemoryKind::HostVisible`] has to be mapped.
    pub kind: MemoryKind,
}

/// A piece of device memory.
#[derive(Clone, Copy, Debug)]
pub struct HostMemory {
    /// The memory object.
    pub memory: vk::DeviceMemory,
    /// Bytes in front of the piece there.
    pub offset: u64,
    /// Where the piece begins in the address space, if it is mapped.
    pub mapped: Option<NonNull<u8>>,
    /// Whatever the allocator wants to know it by.
    pub id: u64,
}

// SAFETY: an address of mapped device memory is valid on every thread; the engine orders accesses to it.
unsafe impl Send for HostMemory {}
// SAFETY: as above; a shared reference gives no access to the memory.
unsafe impl Sync for HostMemory {}

/// A host's allocator, which all buffers of a context get their memory from: see [`super::ForeignDevice::allocator`].
///
/// It is called by what allocates ([`super::Context::allocate`], uploads, `Renderer::reserve`), never while a frame is
/// recorded; and by what frees: whoever drops the last holder of a buffer, on whatever thread that is. Such a holder is also
/// the slot that a frame was recorded through, until it is recorded again or released ([`super::RecordSlot::release`]).
///
/// # Safety
/// - What [`HostAllocator::allocate`] returns is memory of the context's device of one of the requested types, with the
///   requested size and alignment, and nobody else uses the piece before it is freed;
/// - if it is mapped, then at the address given, for as long, and the memory type is host-coherent.
pub unsafe trait HostAllocator: Send + Sync {
    /// Allocates a piece of memory.
    ///
    /// # Errors
    /// Why it cannot, in one line.
    fn allocate(&self, request: &MemoryRequest<'_>) -> Result<HostMemory, String>;

    /// Takes a piece back that is not in use any more.
    fn free(&self, memory: HostMemory);
}
