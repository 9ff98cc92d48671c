//! Device memory. Requests are packed into blocks of one VkBuffer and one allocation each.

use super::allocator::{HostAllocator, HostMemory, MemoryKind, MemoryRequest};
use super::debug::vk_error;
use super::memory_types::{self, Place};
use super::open_device::Device;
use super::texels::TexelViews;
use crate::{Error, Result};
use ash::vk;
use std::ptr::NonNull;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

/// Alignment of every buffer in its block. No device requires more.
pub const PLACEMENT_ALIGNMENT: u64 = 256;
/// Smallest size of a buffer, bytes.
pub const SMALLEST_BUFFER: u64 = 16;

/// Buffers whose distance is a multiple of this, bytes, begin in the same cache sets of a processor. The scattered keys and
/// values of a sort then evict each other: 1.38 times the time at 2^22 pairs.
const CACHE_WAY: u64 = 64 << 10;
/// Smallest size, bytes, of buffers that are staggered.
const STAGGERED: u64 = 1 << 20;
/// Offset of each buffer in those sets from the previous buffer, bytes. It exceeds the distance of one digit's keys from
/// their expected position. The keys and values that a sort writes are two such offsets apart.
const STAGGER: u64 = 33 * PLACEMENT_ALIGNMENT;

/// Returns the padding after a buffer of this size, bytes.
const fn stagger_behind(bytes: u64) -> u64 {
    let apart = bytes.next_multiple_of(PLACEMENT_ALIGNMENT) % CACHE_WAY;
    if bytes < STAGGERED { 0 } else { (CACHE_WAY + STAGGER - apart) % CACHE_WAY }
}

/// Position of each request.
#[derive(Debug, PartialEq)]
pub struct Packing {
    /// Bytes of each block.
    pub blocks: Vec<u64>,
    /// Block and offset of each request, in the order of the requests.
    pub places: Vec<(usize, u64)>,
}

/// Packs buffers of the given sizes into blocks of at most `largest_block` bytes, in order.
///
/// # Errors
/// Index of the first request that is larger than a block.
pub fn pack(sizes: &[u64], largest_block: u64) -> Result<Packing, usize> {
    let mut packing = Packing { blocks: Vec::new(), places: Vec::with_capacity(sizes.len()) };
    let mut stagger = 0;
    for (index, &bytes) in sizes.iter().enumerate() {
        let bytes = bytes.max(SMALLEST_BUFFER).next_multiple_of(4);
        if bytes > largest_block {
            return Err(index);
        }
        let used = packing.blocks.last().map(|b| b.next_multiple_of(PLACEMENT_ALIGNMENT) + stagger);
        stagger = stagger_behind(bytes);
        match used {
            Some(used) if used + bytes <= largest_block => {
                packing.places.push((packing.blocks.len() - 1, used));
                if let Some(block) = packing.blocks.last_mut() {
                    *block = used + bytes;
                }
            }
            _ => {
                packing.places.push((packing.blocks.len(), 0));
                packing.blocks.push(bytes);
            }
        }
    }
    Ok(packing)
}

/// Flags of a memory type that is mapped, and needs no flushes.
const MAPPABLE: vk::MemoryPropertyFlags = vk::MemoryPropertyFlags::from_raw(
    vk::MemoryPropertyFlags::HOST_VISIBLE.as_raw() | vk::MemoryPropertyFlags::HOST_COHERENT.as_raw(),
);

/// Address of a mapped block. Accessed only under the block's lock.
struct Mapping(NonNull<u8>);

// SAFETY: an address of mapped device memory is valid on every thread; the lock around it orders host accesses.
unsafe impl Send for Mapping {}

/// One VkBuffer with its memory.
pub(super) struct Block {
    inner: Arc<Device>,
    pub(super) raw: vk::Buffer,
    /// Null if the memory is a host's.
    memory: vk::DeviceMemory,
    /// Memory from the host's allocator.
    hosted: Option<HostMemory>,
    mapping: Option<Mutex<Mapping>>,
    bytes: u64,
    arena: Arc<str>,
    pub(super) kind: MemoryKind,
    /// True if the processor caches the mapping, so that reading it is fast.
    cached: bool,
    /// Id of the block in the hazard checker.
    pub(super) id: u64,
    /// True if the context owns the buffer and its memory.
    owned: bool,
    /// Block of the owning context, if another context lent this buffer; kept alive.
    lender: Option<Arc<Block>>,
    /// The recording that kept the block last: see [`super::resources::Kept`].
    pub(super) kept_by: AtomicU64,
    /// Submissions that use the block and were not waited for.
    pub(super) in_flight: AtomicU32,
    pub(super) texels: TexelViews,
    /// Offset, size and name of each buffer with guard bands.
    #[cfg(feature = "testing")]
    pub(super) guarded: Mutex<Vec<(u64, u64, &'static str)>>,
}

/// Next id of a block or image.
pub(super) static NEXT_ID: AtomicU64 = AtomicU64::new(1);

impl Block {
    pub(super) fn new(
        inner: &Arc<Device>,
        arena: &Arc<str>,
        number: usize,
        bytes: u64,
        kind: MemoryKind,
    ) -> Result<Self> {
        Self::of_types(inner, (arena, number), bytes, kind, u32::MAX)
    }

    /// Allocates in one of the allowed memory types.
    pub(super) fn of_types(
        inner: &Arc<Device>,
        (arena, number): (&Arc<str>, usize),
        bytes: u64,
        kind: MemoryKind,
        allowed: u32,
    ) -> Result<Self> {
        let usage = vk::BufferUsageFlags::STORAGE_BUFFER
            | vk::BufferUsageFlags::UNIFORM_TEXEL_BUFFER
            | vk::BufferUsageFlags::UNIFORM_BUFFER
            | vk::BufferUsageFlags::INDIRECT_BUFFER
            | vk::BufferUsageFlags::TRANSFER_SRC
            | vk::BufferUsageFlags::TRANSFER_DST;
        let info = vk::BufferCreateInfo::default().size(bytes).usage(usage);
        // SAFETY: valid create info, a device that `inner` keeps alive.
        let raw = unsafe { inner.device.create_buffer(&info, None) }.map_err(vk_error("vkCreateBuffer"))?;
        let mut block = Self {
            inner: inner.clone(),
            raw,
            memory: vk::DeviceMemory::null(),
            hosted: None,
            mapping: None,
            bytes,
            arena: arena.clone(),
            kind,
            cached: true,
            id: NEXT_ID.fetch_add(1, Ordering::Relaxed),
            owned: true,
            lender: None,
            kept_by: AtomicU64::new(0),
            in_flight: AtomicU32::new(0),
            texels: Default::default(),
            #[cfg(feature = "testing")]
            guarded: Mutex::default(),
        };
        inner.registry.add(arena, bytes, kind);
        block.bind_memory(kind, allowed)?;
        inner.names.name(block.raw, &format!("{arena}#{number}"));
        if block.hosted.is_none() {
            inner.names.name(block.memory, &format!("{arena}#{number} memory"));
        }
        Ok(block)
    }

    /// Wraps a host's buffer.
    pub(super) fn foreign(inner: &Arc<Device>, raw: vk::Buffer, bytes: u64) -> Self {
        Self {
            inner: inner.clone(),
            raw,
            memory: vk::DeviceMemory::null(),
            hosted: None,
            mapping: None,
            bytes,
            arena: "host".into(),
            kind: MemoryKind::Device,
            cached: true,
            id: NEXT_ID.fetch_add(1, Ordering::Relaxed),
            owned: false,
            lender: None,
            kept_by: AtomicU64::new(0),
            in_flight: AtomicU32::new(0),
            texels: Default::default(),
            #[cfg(feature = "testing")]
            guarded: Mutex::default(),
        }
    }

    /// Wraps a buffer of another context on the same VkDevice.
    pub(super) fn lent(inner: &Arc<Device>, lender: &Arc<Block>) -> Self {
        let mut lent = Self::foreign(inner, lender.raw, lender.bytes);
        lent.lender = Some(lender.clone());
        lent
    }

    pub(super) fn bytes(&self) -> u64 {
        self.bytes
    }

    pub(super) fn is_of(&self, inner: &Arc<Device>) -> bool {
        Arc::ptr_eq(&self.inner, inner)
    }

    pub(super) fn device(&self) -> &Device {
        &self.inner
    }

    fn bind_memory(&mut self, kind: MemoryKind, allowed: u32) -> Result<()> {
        let device = &self.inner.device;
        // SAFETY: `raw` was created from this device.
        let needs = unsafe { device.get_buffer_memory_requirements(self.raw) };
        if let Some(allocator) = self.inner.allocator.clone() {
            return self.bind_hosted(&*allocator, needs, kind);
        }
        let types = self.inner.memory.memory_types_as_slice();
        let index = self.inner.memory_type(needs.memory_type_bits & allowed, kind)?;
        let info = vk::MemoryAllocateInfo::default().allocation_size(needs.size).memory_type_index(index);
        // SAFETY: the type index is valid, and the buffer is bound once, at offset 0, to memory of its own.
        unsafe {
            self.memory = device.allocate_memory(&info, None).map_err(|e| self.out_of_memory(e))?;
            device.bind_buffer_memory(self.raw, self.memory, 0).map_err(vk_error("vkBindBufferMemory"))?;
        }
        let flags = types[index as usize].property_flags;
        self.cached = self.inner.caches(flags);
        // Reading a GPU's own memory word by word over the bus is slower than staging: see `is_read_mapped`.
        if flags.contains(MAPPABLE) && (kind != MemoryKind::Device || self.inner.place.is_mapped()) {
            // SAFETY: host-visible memory, mapped once, whole; freeing it unmaps it.
            let address =
                unsafe { device.map_memory(self.memory, 0, vk::WHOLE_SIZE, vk::MemoryMapFlags::empty()) };
            let address = NonNull::new(address.map_err(vk_error("vkMapMemory"))?.cast());
            self.mapping = address.map(|a| Mutex::new(Mapping(a)));
        }
        Ok(())
    }

    /// Binds memory from the host's allocator.
    fn bind_hosted(
        &mut self,
        allocator: &dyn HostAllocator,
        requirements: vk::MemoryRequirements,
        kind: MemoryKind,
    ) -> Result<()> {
        let request = MemoryRequest { name: &self.arena, requirements, kind };
        let failed = |result: String| {
            let result = format!("{result}, for {} bytes of arena '{}'", self.bytes, self.arena);
            Error::Vulkan { call: "the host's allocator", result, remedy: String::new() }
        };
        let piece = allocator.allocate(&request).map_err(failed)?;
        self.hosted = Some(piece);
        if kind == MemoryKind::HostVisible && piece.mapped.is_none() {
            return Err(failed("it has not mapped host-visible memory".into()));
        }
        // SAFETY: the allocator guarantees the requested size, alignment and type; the buffer is bound once.
        let bound = unsafe { self.inner.device.bind_buffer_memory(self.raw, piece.memory, piece.offset) };
        bound.map_err(vk_error("vkBindBufferMemory"))?;
        if kind != MemoryKind::Device || self.inner.place == Place::Unified {
            self.mapping = piece.mapped.map(|address| Mutex::new(Mapping(address)));
        }
        Ok(())
    }

    /// Returns the error of a failed allocation, with its purpose.
    fn out_of_memory(&self, result: vk::Result) -> Error {
        match vk_error("vkAllocateMemory")(result) {
            Error::Vulkan { call, result, remedy } => {
                let result = format!("{result}, for {} bytes of arena '{}'", self.bytes, self.arena);
                Error::Vulkan { call, result, remedy }
            }
            other => other,
        }
    }

    pub(super) fn is_mapped(&self) -> bool {
        self.mapping.is_some()
    }

    /// True if reads use the mapping. Uncached memory is read word by word; for host-visible memory there is no faster way.
    pub(super) fn is_read_mapped(&self) -> bool {
        self.is_mapped() && (self.cached || self.kind != MemoryKind::Device)
    }

    /// Copies into the block. Returns false if it is not mapped.
    ///
    /// # Panics
    /// If the range exceeds the block.
    pub(super) fn write_mapped(&self, offset: u64, bytes: &[u8]) -> bool {
        let Some(mapping) = &self.mapping else { return false };
        assert!(offset + bytes.len() as u64 <= self.bytes, "write outside of a block");
        let mapping = mapping.lock().unwrap_or_else(PoisonError::into_inner);
        // SAFETY: within the mapping (asserted), to which the lock gives this thread sole access; no
        // submission that uses the block is running (`Buffer` checks).
        unsafe {
            let to = mapping.0.as_ptr().add(offset as usize);
            std::ptr::copy_nonoverlapping(bytes.as_ptr(), to, bytes.len());
        }
        true
    }

    /// Copies out of the block. Returns false if it is not mapped.
    ///
    /// # Panics
    /// If the range exceeds the block.
    pub(super) fn read_mapped(&self, offset: u64, bytes: &mut [u8]) -> bool {
        let Some(mapping) = &self.mapping else { return false };
        assert!(offset + bytes.len() as u64 <= self.bytes, "read outside of a block");
        let mapping = mapping.lock().unwrap_or_else(PoisonError::into_inner);
        // SAFETY: as in `write_mapped`.
        unsafe {
            let from = mapping.0.as_ptr().add(offset as usize);
            std::ptr::copy_nonoverlapping(from, bytes.as_mut_ptr(), bytes.len());
        }
        true
    }
}

impl Drop for Block {
    fn drop(&mut self) {
        self.texels.destroy(&self.inner.device);
        if !self.owned {
            return;
        }
        self.inner.registry.remove(&self.arena, self.bytes, self.kind);
        // SAFETY: recordings and submissions hold the block until they are done with it, so it is idle; null handles
        // are allowed.
        unsafe {
            self.inner.device.destroy_buffer(self.raw, None);
            self.inner.device.free_memory(self.memory, None);
        }
        if let (Some(allocator), Some(piece)) = (&self.inner.allocator, self.hosted.take()) {
            allocator.free(piece);
        }
    }
}

impl Device {
    fn caches(&self, flags: vk::MemoryPropertyFlags) -> bool {
        #[cfg(feature = "testing")]
        if self.force_uncached {
            return false;
        }
        flags.contains(vk::MemoryPropertyFlags::HOST_CACHED)
    }

    /// True if the host reads and writes device memory in place, without staging.
    pub(super) fn reads_mapped(&self) -> bool {
        let of_type = |index: u32| self.memory.memory_types_as_slice()[index as usize].property_flags;
        let best = self.memory_type(u32::MAX, MemoryKind::Device).map(of_type);
        // The memory of a host's allocator is known only after it is allocated.
        let direct = self.allocator.is_some()
            || best.is_ok_and(|flags| flags.contains(MAPPABLE) && self.caches(flags));
        self.place == Place::Unified && direct
    }

    /// Returns the best of the allowed memory types.
    pub(super) fn memory_type(&self, allowed: u32, kind: MemoryKind) -> Result<u32> {
        memory_types::best(&self.memory, allowed, kind, self.place).ok_or_else(|| {
            let device = self.description.name.clone();
            Error::MissingFeature { device, feature: format!("a memory type for {kind:?} memory") }
        })
    }
}
