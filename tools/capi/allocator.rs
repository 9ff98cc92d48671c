//! Memory from a host's own allocator, in C.

use ashsplat::ash::{vk, vk::Handle};
use ashsplat::vk::{HostAllocator, HostMemory, MemoryKind, MemoryRequest};
use ashsplat::{Error, Result};
use std::ffi::{CString, c_char, c_void};
use std::ptr::NonNull;

/// What is to be allocated, for a buffer.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct AshsplatMemoryRequest {
    /// What it is for, for debugging; valid during the call.
    pub name: *const c_char,
    /// Bytes.
    pub bytes: u64,
    /// The piece begins at a multiple of this in its memory.
    pub alignment: u64,
    /// Bit i: memory type i is allowed.
    pub memory_types: u32,
    /// Whether it must be mapped; otherwise it should be device-local.
    pub host_visible: bool,
}

/// A piece of device memory.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct AshsplatMemory {
    /// VkDeviceMemory.
    pub memory: u64,
    /// Byte offset of the piece in the memory object.
    pub offset: u64,
    /// Host address of the piece if it is mapped, otherwise NULL.
    pub mapped: *mut c_void,
    /// An identifier for the allocator's own use.
    pub id: u64,
}

/// A host's allocator, which provides the memory of all buffers. Functions that allocate or free call it,
/// also from other threads. Recording never allocates. But it frees memory that only the slot's last frame still
/// used, unless ashsplat_slot_release has done so.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct AshsplatAllocator {
    /// Set by ASHSPLAT_INIT.
    pub struct_size: u32,
    /// Handed to both functions.
    pub user: *mut c_void,
    /// Allocates a piece; false when it cannot. Mapped memory has to be host-coherent.
    pub allocate: Option<
        unsafe extern "C" fn(
            user: *mut c_void,
            request: *const AshsplatMemoryRequest,
            memory: *mut AshsplatMemory,
        ) -> bool,
    >,
    /// Frees a piece that is not in use any more.
    pub free: Option<unsafe extern "C" fn(user: *mut c_void, memory: AshsplatMemory)>,
}

type Allocate = unsafe extern "C" fn(*mut c_void, *const AshsplatMemoryRequest, *mut AshsplatMemory) -> bool;
type Free = unsafe extern "C" fn(*mut c_void, AshsplatMemory);

/// A host's allocator as the engine uses it.
pub(super) struct Adapter {
    user: *mut c_void,
    allocate: Allocate,
    free: Free,
}

// SAFETY: the allocator's owner promises that it may be called from any thread.
unsafe impl Send for Adapter {}
// SAFETY: as above.
unsafe impl Sync for Adapter {}

impl Adapter {
    /// # Safety
    /// The functions keep the contract of [`HostAllocator`] and of their own documentation, from any thread, as long as
    /// the adapter lives.
    pub(super) unsafe fn new(allocator: &AshsplatAllocator) -> Result<Self> {
        let (Some(allocate), Some(free)) = (allocator.allocate, allocator.free) else {
            return Err(Error::argument("allocator", "a function is null"));
        };
        Ok(Self { user: allocator.user, allocate, free })
    }
}

// SAFETY: promised by the adapter's creator.
unsafe impl HostAllocator for Adapter {
    fn allocate(&self, request: &MemoryRequest<'_>) -> Result<HostMemory, String> {
        let name = CString::new(request.name).unwrap_or_default();
        let needs = request.requirements;
        let request = AshsplatMemoryRequest {
            name: name.as_ptr(),
            bytes: needs.size,
            alignment: needs.alignment,
            memory_types: needs.memory_type_bits,
            host_visible: request.kind == MemoryKind::HostVisible,
        };
        let mut piece = AshsplatMemory { memory: 0, offset: 0, mapped: std::ptr::null_mut(), id: 0 };
        // SAFETY: the host's function with valid arguments; both pointers live through the call.
        let done = unsafe { (self.allocate)(self.user, &request, &mut piece) };
        if !done || piece.memory == 0 {
            return Err(format!("it has no {} bytes", needs.size));
        }
        Ok(HostMemory {
            memory: vk::DeviceMemory::from_raw(piece.memory),
            offset: piece.offset,
            mapped: NonNull::new(piece.mapped.cast()),
            id: piece.id,
        })
    }

    fn free(&self, memory: HostMemory) {
        let piece = AshsplatMemory {
            memory: memory.memory.as_raw(),
            offset: memory.offset,
            mapped: memory.mapped.map_or(std::ptr::null_mut(), |address| address.as_ptr().cast()),
            id: memory.id,
        };
        // SAFETY: a piece of this allocator that is no longer used.
        unsafe { (self.free)(self.user, piece) }
    }
}
