//! Device memory. Requests are packed into blocks of one VkBuffer and one allocation each; a [`Buffer`] is a named range of
//! a block.

use super::debug::vk_error;
use super::format::TexelFormat;
use super::limits::Limits;
use super::lock::lock;
use super::memory_types::{HostAllocator, HostMemory, Location, MAPPABLE, MemoryKind, MemoryRequest, best};
use super::open_device::Device;
use crate::error::{Error, Result};
use ash::vk;
use std::collections::HashMap;
use std::ptr::NonNull;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};

/// Alignment of every buffer in its block. No device requires more.
pub const PLACEMENT_ALIGNMENT: u64 = 256;
/// Smallest size of a buffer, bytes.
pub const SMALLEST_BUFFER: u64 = 16;

/// Buffers whose distance is a multiple of this, bytes, begin in the same cache sets of a processor. The scattered keys and
/// values of a sort then evict each other: 1.38 times the time at 2^22 pairs.
const CACHE_WAY: u64 = 64 << 10;
/// Smallest size, bytes, of buffers that are staggered.
const STAGGERED: u64 = 1 << 20;
/// Offset of each buffer in those sets from that of the request before, bytes. It exceeds the distance of one digit's keys
/// from their expected position. The keys and values that a sort writes are two such offsets apart.
const STAGGER: u64 = 33 * PLACEMENT_ALIGNMENT;

/// Position of each request.
#[derive(Debug, PartialEq)]
pub struct Packing {
    /// Bytes of each block.
    pub blocks: Vec<u64>,
    /// Block and offset of each request, in the order of the requests.
    pub places: Vec<(usize, u64)>,
}

/// Returns the size of a buffer for a request of this many bytes.
pub(super) fn padded(bytes: u64) -> u64 {
    bytes.max(SMALLEST_BUFFER).next_multiple_of(4)
}

/// First and last step of a sequence of work between which a buffer has contents. Buffers of one allocation share memory if
/// their lives have no step in common.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Life {
    /// First step that writes the buffer.
    pub first: u8,
    /// Last step that reads or writes it.
    pub last: u8,
}

impl Life {
    /// Life of a buffer that shares its memory with no other one.
    pub const ALWAYS: Self = Self { first: 0, last: u8::MAX };

    fn meets(self, other: Self) -> bool {
        self.first <= other.last && other.first <= self.last
    }
}

/// Packs buffers of the given sizes into blocks of at most `largest_block` bytes, each at the lowest place that is free
/// during its life. Buffers without an entry in `lives` live always; they come first, in order. The others are
/// placed by bytes times steps, largest first, because the later ones then fill the gaps.
///
/// # Errors
/// Index of the first request that is larger than a block.
pub fn pack(sizes: &[u64], lives: &[Life], largest_block: u64) -> Result<Packing, usize> {
    if let Some(large) = sizes.iter().position(|&bytes| padded(bytes) > largest_block) {
        return Err(large);
    }
    let mut order: Vec<usize> = (0..sizes.len()).collect();
    order.sort_by_key(|&index| {
        let steps = lives.get(index).map(|life| u64::from(life.last - life.first) + 1);
        std::cmp::Reverse(steps.map_or(u64::MAX, |steps| sizes[index].saturating_mul(steps)))
    });
    let mut packing = Packing { blocks: Vec::new(), places: vec![(0, 0); sizes.len()] };
    // Per block: offset, bytes and life of its buffers, by offset.
    let mut taken: Vec<Vec<(u64, u64, Life)>> = Vec::new();
    for index in order {
        let (bytes, life) = (padded(sizes[index]), lives.get(index).copied().unwrap_or(Life::ALWAYS));
        let stagger = index as u64 * STAGGER % CACHE_WAY;
        let begin = |at: u64| match bytes < STAGGERED {
            true => at.next_multiple_of(PLACEMENT_ALIGNMENT),
            false => at + (CACHE_WAY + stagger - at % CACHE_WAY) % CACHE_WAY,
        };
        let free = |taken: &Vec<(u64, u64, Life)>| {
            let mut at = begin(0);
            for &(offset, others, _) in taken.iter().filter(|(.., other)| other.meets(life)) {
                if at + bytes <= offset {
                    break;
                }
                at = begin(offset + others).max(at);
            }
            at
        };
        let fits = |(_, at): &(usize, u64)| at + bytes <= largest_block;
        let (block, at) = taken.iter().map(free).enumerate().find(fits).unwrap_or_else(|| {
            packing.blocks.push(0);
            (packing.blocks.len() - 1, 0)
        });
        taken.resize(packing.blocks.len(), Vec::new());
        let place = taken[block].partition_point(|(offset, ..)| *offset <= at);
        taken[block].insert(place, (at, bytes, life));
        packing.blocks[block] = packing.blocks[block].max(at + bytes);
        packing.places[index] = (block, at);
    }
    Ok(packing)
}

/// Address of a mapped block. Accessed only under the block's lock.
struct Mapping(NonNull<u8>);

// SAFETY: an address of mapped device memory is valid on every thread; the lock around it orders host accesses.
unsafe impl Send for Mapping {}

pub(super) struct Block {
    pub(super) inner: Arc<Device>,
    pub(super) raw: vk::Buffer,
    /// Null if the memory is a host's.
    memory: vk::DeviceMemory,
    hosted: Option<HostMemory>,
    mapping: Option<Mutex<Mapping>>,
    pub(super) bytes: u64,
    arena: &'static str,
    pub(super) kind: MemoryKind,
    /// True if the processor caches the mapping, so that reading it is fast.
    cached: bool,
    pub(super) id: u64,
    /// True if the context owns the buffer and its memory.
    owned: bool,
    /// Block of the owning context, if another context lent this buffer; kept alive.
    lender: Option<Arc<Block>>,
    /// The recording that kept the block last: see [`super::recorder::Kept`].
    pub(super) retained_by: AtomicU64,
    /// Submissions that use the block and were not waited for.
    pub(super) in_flight: AtomicU32,
    /// Views of ranges (offset, bytes) as texels.
    texels: Mutex<HashMap<(u64, u64, TexelFormat), vk::BufferView>>,
    /// Offset, size and name of each buffer with guard bands.
    pub(super) guarded: Mutex<Vec<(u64, u64, &'static str)>>,
}

/// Next id of a block or image.
pub(super) static NEXT_ID: AtomicU64 = AtomicU64::new(1);

impl Block {
    /// A block with a VkBuffer of the context, without memory, or with a buffer of a host.
    fn with(inner: &Arc<Device>, arena: &'static str, raw: vk::Buffer, bytes: u64, kind: MemoryKind) -> Self {
        Self {
            inner: inner.clone(),
            raw,
            memory: vk::DeviceMemory::null(),
            hosted: None,
            mapping: None,
            bytes,
            arena,
            kind,
            cached: true,
            id: NEXT_ID.fetch_add(1, Ordering::Relaxed),
            owned: false,
            lender: None,
            retained_by: AtomicU64::new(0),
            in_flight: AtomicU32::new(0),
            texels: Default::default(),
            guarded: Mutex::default(),
        }
    }

    /// Allocates in one of the allowed memory types.
    pub(super) fn new(
        inner: &Arc<Device>,
        (arena, number): (&'static str, usize),
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
        let mut block = Self::with(inner, arena, raw, bytes, kind);
        block.owned = true;
        inner.registry.add(arena, bytes, kind);
        block.bind_memory(allowed)?;
        inner.names.name(block.raw, &format!("{arena}#{number}"));
        if block.hosted.is_none() {
            inner.names.name(block.memory, &format!("{arena}#{number} memory"));
        }
        Ok(block)
    }

    pub(super) fn foreign(inner: &Arc<Device>, raw: vk::Buffer, bytes: u64) -> Self {
        Self::with(inner, "host", raw, bytes, MemoryKind::Device)
    }

    /// Wraps a buffer of another context on the same VkDevice.
    pub(super) fn lent(inner: &Arc<Device>, lender: &Arc<Block>) -> Self {
        let mut lent = Self::foreign(inner, lender.raw, lender.bytes);
        lent.lender = Some(lender.clone());
        lent
    }

    pub(super) fn is_of(&self, inner: &Arc<Device>) -> bool {
        Arc::ptr_eq(&self.inner, inner)
    }

    fn bind_memory(&mut self, allowed: u32) -> Result<()> {
        let device = &self.inner.device;
        // SAFETY: `raw` was created from this device.
        let needs = unsafe { device.get_buffer_memory_requirements(self.raw) };
        if let Some(allocator) = self.inner.allocator.clone() {
            return self.bind_hosted(&*allocator, needs);
        }
        let index = self.inner.memory_type(needs.memory_type_bits & allowed, self.kind)?;
        let info = vk::MemoryAllocateInfo::default().allocation_size(needs.size).memory_type_index(index);
        // SAFETY: the type index is valid, and the buffer is bound once, at offset 0, to memory of its own.
        unsafe {
            self.memory = device.allocate_memory(&info, None).map_err(|e| self.out_of_memory(e))?;
            device.bind_buffer_memory(self.raw, self.memory, 0).map_err(vk_error("vkBindBufferMemory"))?;
        }
        let flags = self.inner.memory.memory_types_as_slice()[index as usize].property_flags;
        self.cached = self.inner.caches(flags);
        // Reading a GPU's own memory word by word over the bus is slower than staging: see `is_read_mapped`.
        if flags.contains(MAPPABLE) && (self.kind != MemoryKind::Device || self.inner.location.is_mapped()) {
            // SAFETY: host-visible memory, mapped once, whole; freeing it unmaps it.
            let address =
                unsafe { device.map_memory(self.memory, 0, vk::WHOLE_SIZE, vk::MemoryMapFlags::empty()) };
            let address = NonNull::new(address.map_err(vk_error("vkMapMemory"))?.cast());
            self.mapping = address.map(|a| Mutex::new(Mapping(a)));
        }
        Ok(())
    }

    fn bind_hosted(
        &mut self,
        allocator: &dyn HostAllocator,
        requirements: vk::MemoryRequirements,
    ) -> Result<()> {
        let kind = self.kind;
        let piece = allocator.allocate(&MemoryRequest { name: self.arena, requirements, kind });
        let refused = |reason: &str| {
            let (call, result) = ("the host's allocator", self.with_purpose(reason));
            Error::Vulkan { call, result, remedy: String::new() }
        };
        let piece = piece.map_err(|reason| refused(&reason))?;
        if kind == MemoryKind::HostVisible && piece.mapped.is_none() {
            allocator.free(piece);
            return Err(refused("it has not mapped host-visible memory"));
        }
        self.hosted = Some(piece);
        // SAFETY: the allocator guarantees the requested size, alignment and type; the buffer is bound once.
        let bound = unsafe { self.inner.device.bind_buffer_memory(self.raw, piece.memory, piece.offset) };
        bound.map_err(vk_error("vkBindBufferMemory"))?;
        if kind != MemoryKind::Device || self.inner.location == Location::Unified {
            self.mapping = piece.mapped.map(|address| Mutex::new(Mapping(address)));
        }
        Ok(())
    }

    fn with_purpose(&self, failure: &str) -> String {
        format!("{failure}, for {} bytes of arena '{}'", self.bytes, self.arena)
    }

    fn out_of_memory(&self, result: vk::Result) -> Error {
        let mut error = vk_error("vkAllocateMemory")(result);
        if let Error::Vulkan { result, .. } = &mut error {
            *result = self.with_purpose(result);
        }
        error
    }

    pub(super) fn is_mapped(&self) -> bool {
        self.mapping.is_some()
    }

    /// True if reads use the mapping. Uncached memory is read word by word; for host-visible memory there is no faster way.
    pub(super) fn is_read_mapped(&self) -> bool {
        self.is_mapped() && (self.cached || self.kind != MemoryKind::Device)
    }

    /// Returns the view of a range, created on first use. Its offset must be aligned and its texels within the limit.
    pub(super) fn texel_view(&self, offset: u64, bytes: u64, format: TexelFormat) -> Result<vk::BufferView> {
        let mut views = lock(&self.texels);
        if let Some(view) = views.get(&(offset, bytes, format)) {
            return Ok(*view);
        }
        let info = vk::BufferViewCreateInfo::default()
            .buffer(self.raw)
            .format(format.raw())
            .offset(offset)
            .range(bytes / format.bytes() * format.bytes());
        // SAFETY: a range of a buffer with UNIFORM_TEXEL_BUFFER usage, checked by the recorder; every device has to
        // support both formats.
        let view = unsafe { self.inner.device.create_buffer_view(&info, None) };
        let view = view.map_err(vk_error("vkCreateBufferView"))?;
        views.insert((offset, bytes, format), view);
        Ok(view)
    }

    /// Copies into the block. Returns false if it is not mapped.
    pub(super) fn write_mapped(&self, offset: u64, bytes: &[u8]) -> bool {
        self.access_mapped("write", offset, bytes.len(), |to| {
            // SAFETY: as `access_mapped` says.
            unsafe { std::ptr::copy_nonoverlapping(bytes.as_ptr(), to, bytes.len()) }
        })
    }

    /// Copies out of the block. Returns false if it is not mapped.
    pub(super) fn read_mapped(&self, offset: u64, bytes: &mut [u8]) -> bool {
        self.access_mapped("read", offset, bytes.len(), |from| {
            // SAFETY: as `access_mapped` says.
            unsafe { std::ptr::copy_nonoverlapping(from, bytes.as_mut_ptr(), bytes.len()) }
        })
    }

    /// Passes an address to `access` where this many bytes are mapped. The lock gives this thread sole access to them, and
    /// no submission that uses the block is running (`Buffer` checks). False if the block is not mapped.
    fn access_mapped(&self, what: &str, offset: u64, bytes: usize, access: impl FnOnce(*mut u8)) -> bool {
        let Some(mapping) = &self.mapping else { return false };
        assert!(offset + bytes as u64 <= self.bytes, "{what} outside of a block");
        let mapping = lock(mapping);
        // SAFETY: within the mapping, as asserted.
        access(unsafe { mapping.0.as_ptr().add(offset as usize) });
        true
    }
}

impl Drop for Block {
    fn drop(&mut self) {
        for (_, view) in lock(&self.texels).drain() {
            // SAFETY: recordings and submissions hold the block until they are done with it, so the view is idle.
            unsafe { self.inner.device.destroy_buffer_view(view, None) }
        }
        if !self.owned {
            return;
        }
        self.inner.registry.remove(self.arena, self.bytes, self.kind);
        // SAFETY: idle, as above; null handles are allowed.
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
        flags.contains(vk::MemoryPropertyFlags::HOST_CACHED) && !self.force_uncached
    }

    /// True if the host reads and writes device memory in place, without staging.
    pub(super) fn reads_mapped(&self) -> bool {
        let of_type = |index: u32| self.memory.memory_types_as_slice()[index as usize].property_flags;
        let best = self.memory_type(u32::MAX, MemoryKind::Device).map(of_type);
        // The memory of a host's allocator is known only after it is allocated.
        let direct = self.allocator.is_some()
            || best.is_ok_and(|flags| flags.contains(MAPPABLE) && self.caches(flags));
        self.location == Location::Unified && direct
    }

    pub(super) fn memory_type(&self, allowed: u32, kind: MemoryKind) -> Result<u32> {
        best(&self.memory, allowed, kind, self.location).ok_or_else(|| {
            let device = self.description.name.clone();
            Error::MissingFeature { device, feature: format!("a memory type for {kind:?} memory") }
        })
    }
}

/// A range of a block of device memory. Clones and [`Buffer::range`]s share the memory and keep it alive.
#[derive(Clone)]
pub struct Buffer {
    block: Arc<Block>,
    offset: u64,
    bytes: u64,
    name: &'static str,
}

impl Buffer {
    pub(super) fn new(block: Arc<Block>, offset: u64, bytes: u64, name: &'static str) -> Self {
        Self { block, offset, bytes, name }
    }

    /// The Vulkan buffer, and the byte offset of this range in it.
    pub fn handle(&self) -> (vk::Buffer, u64) {
        (self.raw(), self.offset)
    }

    /// Size, bytes.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Name in the allocation request.
    pub fn name(&self) -> &'static str {
        self.name
    }

    /// Returns a part of the buffer, under the same name.
    ///
    /// # Panics
    /// If the part does not lie inside.
    pub fn range(&self, offset: u64, bytes: u64) -> Buffer {
        let inside = offset.checked_add(bytes).is_some_and(|end| end <= self.bytes);
        assert!(inside, "range {offset}+{bytes} lies outside of '{}' of {} bytes", self.name, self.bytes);
        Buffer { offset: self.offset + offset, bytes, ..self.clone() }
    }

    /// Returns the whole VkBuffer that contains it, under the same name.
    pub(crate) fn whole(&self) -> Buffer {
        Buffer { offset: 0, bytes: self.block.bytes, ..self.clone() }
    }

    /// True if [`Buffer::whole`] can be bound.
    pub(crate) fn whole_is_bindable(&self, limits: &Limits) -> bool {
        self.block.bytes <= limits.max_storage_buffer_range
    }

    /// True if its VkBuffer could not hold another buffer of its size.
    pub(crate) fn fills_its_memory(&self) -> bool {
        self.block.bytes < 2 * self.bytes
    }

    /// Number of the VkBuffer that contains it, never 0.
    pub(crate) fn memory_id(&self) -> u64 {
        self.block.id
    }

    /// Writes into a [`MemoryKind::HostVisible`] buffer.
    ///
    /// # Errors
    /// [`Error::Argument`] for device memory, outside of the buffer, or while a submission that uses the
    /// buffer's arena is running.
    pub fn write(&self, offset: u64, bytes: &[u8]) -> Result<()> {
        self.check_host("written", offset, bytes.len())?;
        self.block.write_mapped(self.offset + offset, bytes);
        Ok(())
    }

    /// Reads from a [`MemoryKind::HostVisible`] buffer.
    pub fn read(&self, offset: u64, bytes: &mut [u8]) -> Result<()> {
        self.check_host("read", offset, bytes.len())?;
        self.block.read_mapped(self.offset + offset, bytes);
        Ok(())
    }

    fn check_host(&self, done: &str, offset: u64, bytes: usize) -> Result<()> {
        if self.block.kind != MemoryKind::HostVisible {
            return Err(self.refused(format!("device memory cannot be {done} directly")));
        }
        self.check_range(offset, bytes)?;
        self.check_idle()
    }

    pub(super) fn check_range(&self, offset: u64, bytes: usize) -> Result<()> {
        match offset.checked_add(bytes as u64) {
            Some(end) if end <= self.bytes => Ok(()),
            _ => Err(self.refused(format!("{bytes} bytes at {offset} do not fit into its {}", self.bytes))),
        }
    }

    pub(super) fn refused(&self, problem: impl Into<String>) -> Error {
        Error::argument(format!("buffer '{}'", self.name), problem)
    }

    pub(super) fn check_idle(&self) -> Result<()> {
        match self.block.in_flight.load(Ordering::Acquire) {
            0 => Ok(()),
            _ => Err(self.refused("in use by a submission: wait for that first")),
        }
    }

    pub(super) fn block(&self) -> &Arc<Block> {
        &self.block
    }

    pub(super) fn raw(&self) -> vk::Buffer {
        self.block.raw
    }

    pub(super) fn offset(&self) -> u64 {
        self.offset
    }

    /// Returns the bytes of the guard band behind the buffer, if the buffer ends where a guarded one does.
    pub(super) fn guard_behind(&self) -> u64 {
        let end = self.offset + self.bytes;
        let is_guarded = || lock(&self.block.guarded).iter().any(|(offset, bytes, _)| offset + bytes == end);
        if self.block.inner.guard_bands && is_guarded() { GUARD_BYTES } else { 0 }
    }

    /// Records a copy of the whole buffer to the start of another. The caller keeps both until it has run.
    pub(super) fn record_copy(&self, commands: vk::CommandBuffer, to: &Self) {
        let region = vk::BufferCopy::default().src_offset(self.offset).dst_offset(to.offset).size(self.bytes);
        // SAFETY: recording state; ranges within buffers that are kept, with transfer usage, that do not overlap.
        unsafe { self.block.inner.device.cmd_copy_buffer(commands, self.raw(), to.raw(), &[region]) }
    }
}

impl std::fmt::Debug for Buffer {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Buffer('{}', {} bytes)", self.name, self.bytes)
    }
}

/// Setting that messages name for [`ContextOptions::max_memory`](super::ContextOptions::max_memory).
pub(super) const MAX_MEMORY: &str = "--max-memory";

/// Setting that messages name for [`ContextOptions::offload`](super::ContextOptions::offload).
pub(super) const OFFLOAD: &str = "--offload";

pub(super) const UNBOUNDED: u64 = u64::MAX;

impl Device {
    fn guard(&self) -> u64 {
        if self.guard_bands { GUARD_BYTES } else { 0 }
    }

    fn sizes(&self, requests: &[(&'static str, u64)]) -> Vec<u64> {
        requests.iter().map(|(_, bytes)| padded(*bytes) + 2 * self.guard()).collect()
    }

    /// Guard bands tell buffers apart, so that none share memory.
    fn shared<'a>(&self, lives: &'a [Life]) -> &'a [Life] {
        if self.guard_bands { &[] } else { lives }
    }

    /// Returns the bytes that [`Device::allocate`] takes for these requests. If it would refuse them, returns their sum.
    pub(super) fn allocation_bytes(&self, requests: &[(&'static str, u64)], lives: &[Life]) -> u64 {
        let sizes = self.sizes(requests);
        let packing = pack(&sizes, self.shared(lives), self.limits.max_allocation_bytes);
        packing.map_or(sizes, |packing| packing.blocks).iter().sum()
    }

    pub(super) fn max_memory(&self) -> Option<u64> {
        Some(self.max_memory.load(Ordering::Relaxed)).filter(|&bytes| bytes != UNBOUNDED)
    }

    pub(super) fn offload(&self) -> Option<u64> {
        Some(self.offload.load(Ordering::Relaxed)).filter(|&bytes| bytes > 0)
    }

    /// Same as [`Context::allocate_shared`](super::Context::allocate_shared), but without guard bands' contents and audits. `kept_free`:
    /// bytes below the bound that remain for the next transfer.
    pub(super) fn allocate(
        self: &Arc<Self>,
        arena: &'static str,
        requests: &[(&'static str, u64)],
        lives: &[Life],
        kind: MemoryKind,
        kept_free: u64,
    ) -> Result<Vec<Buffer>> {
        let limits = &self.limits;
        let too_large = |what: String, needed, limit| Err(Error::too_large(what, (needed, "bytes"), limit));
        let range = limits.max_storage_buffer_range;
        if let Some(&(name, bytes)) = requests.iter().find(|(_, bytes)| *bytes > range) {
            return too_large(format!("buffer {arena}.{name}"), bytes, (range, "maxStorageBufferRange"));
        }
        let guard = self.guard();
        let sizes = self.sizes(requests);
        let packing = match pack(&sizes, self.shared(lives), limits.max_allocation_bytes) {
            Ok(packing) => packing,
            Err(i) => {
                let limit = (limits.max_allocation_bytes, "maxMemoryAllocationSize");
                return too_large(format!("buffer {arena}.{}", requests[i].0), sizes[i], limit);
            }
        };
        let total: u64 = packing.blocks.iter().sum();
        if total > limits.heap_bytes && kind == MemoryKind::Device && limits.tuning.heap_is_bound {
            return too_large(format!("arena {arena}"), total, (limits.heap_bytes, "device-local heap"));
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
            return too_large(what, used.saturating_add(total), (limit, limit_name));
        }
        let blocks = (packing.blocks.iter().enumerate())
            .map(|(number, &bytes)| Ok(Arc::new(Block::new(self, (arena, number), bytes, kind, u32::MAX)?)))
            .collect::<Result<Vec<_>>>()?;
        let places = requests.iter().zip(&packing.places);
        let buffers = places.map(|(&(name, bytes), &(block, offset))| {
            Buffer::new(blocks[block].clone(), offset + guard, padded(bytes), name)
        });
        Ok(buffers.collect())
    }
}

/// Bytes of the guard band before and after each buffer, which must not be written; a multiple of the buffers' alignment.
/// The writes of one excess workgroup, of 256 invocations with a vec4 each, end within it.
pub(super) const GUARD_BYTES: u64 = 16 * PLACEMENT_ALIGNMENT;
