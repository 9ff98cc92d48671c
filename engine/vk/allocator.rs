//! Kinds of device memory, and memory from a host's own allocator.

use ash::vk;
use std::ptr::NonNull;

/// Kind of memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MemoryKind {
    /// Fastest for kernels. Filled by [`Context::upload`](super::Context::upload), read by
    /// [`Context::download`](super::Context::download).
    Device,
    /// Mapped, coherent and, where possible, cached: [`Buffer::write`](super::Buffer::write) and
    /// [`Buffer::read`](super::Buffer::read).
    HostVisible,
    /// The host's memory, which kernels reach over the bus. Holds data that does not fit into device memory. Uploads and
    /// downloads work as for [`MemoryKind::Device`]. It counts for
    /// [`ContextOptions::offload`](super::ContextOptions::offload) and not for
    /// [`ContextOptions::max_memory`](super::ContextOptions::max_memory).
    Offloaded,
}

/// A request to a host's allocator.
#[derive(Clone, Copy, Debug)]
pub struct MemoryRequest<'a> {
    /// Name of the block, for debugging.
    pub name: &'a str,
    /// Size, alignment and allowed memory types of the buffer.
    pub requirements: vk::MemoryRequirements,
    /// How the memory is used. [`MemoryKind::HostVisible`] must be mapped.
    pub kind: MemoryKind,
}

/// A piece of device memory.
#[derive(Clone, Copy, Debug)]
pub struct HostMemory {
    /// The memory object.
    pub memory: vk::DeviceMemory,
    /// Byte offset of the piece in the memory object.
    pub offset: u64,
    /// Host address of the piece, if it is mapped.
    pub mapped: Option<NonNull<u8>>,
    /// An identifier for the allocator's own use.
    pub id: u64,
}

// SAFETY: an address of mapped device memory is valid on every thread; the engine orders accesses to it.
unsafe impl Send for HostMemory {}
// SAFETY: as above; a shared reference gives no access to the memory.
unsafe impl Sync for HostMemory {}

/// A host's allocator, which provides the memory of all buffers of a context: see [`super::ForeignDevice::allocator`].
///
/// Operations that allocate call it ([`super::Context::allocate`], uploads, `Renderer::reserve`); recording a frame never
/// does. It is also called when the last owner of a buffer is dropped, on the thread of that drop. A slot owns the buffers
/// of its last recording, until it is recorded again or released ([`super::RecordSlot::release`]).
///
/// # Safety
/// - [`HostAllocator::allocate`] returns memory of the context's device, of a requested type, with the requested size and
///   alignment;
/// - the piece has no other user before it is freed;
/// - if the piece is mapped, it is mapped at the given address until it is freed, and the memory type is
///   host-coherent.
pub unsafe trait HostAllocator: Send + Sync {
    /// Allocates a piece of memory.
    ///
    /// # Errors
    /// The reason, in one line.
    fn allocate(&self, request: &MemoryRequest<'_>) -> Result<HostMemory, String>;

    /// Frees a piece that is not in use any more.
    fn free(&self, memory: HostMemory);
}
