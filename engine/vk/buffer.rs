//! A named range of device memory.

use super::allocator::MemoryKind;
use super::limits::Limits;
use super::memory::Block;
use crate::{Error, Result};
use ash::vk;
use std::sync::Arc;
use std::sync::atomic::Ordering;

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
    pub fn name(&self) -> &str {
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
        Buffer { offset: 0, bytes: self.block.bytes(), ..self.clone() }
    }

    /// True if [`Buffer::whole`] can be bound.
    pub(crate) fn whole_is_bindable(&self, limits: &Limits) -> bool {
        self.block.bytes() <= limits.max_storage_buffer_range
    }

    /// True if its VkBuffer could not hold another buffer of its size.
    pub(crate) fn fills_its_memory(&self) -> bool {
        self.block.bytes() < 2 * self.bytes
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
    ///
    /// # Errors
    /// Same as [`Buffer::write`].
    pub fn read(&self, offset: u64, bytes: &mut [u8]) -> Result<()> {
        self.check_host("read", offset, bytes.len())?;
        self.block.read_mapped(self.offset + offset, bytes);
        Ok(())
    }

    fn check_host(&self, done: &str, offset: u64, bytes: usize) -> Result<()> {
        if self.block.kind != MemoryKind::HostVisible {
            let name = format!("buffer '{}'", self.name);
            return Err(Error::argument(name, format!("device memory cannot be {done} directly")));
        }
        self.check_range(offset, bytes)?;
        self.check_idle()
    }

    pub(super) fn check_range(&self, offset: u64, bytes: usize) -> Result<()> {
        match offset.checked_add(bytes as u64) {
            Some(end) if end <= self.bytes => Ok(()),
            _ => Err(Error::argument(
                format!("buffer '{}'", self.name),
                format!("{bytes} bytes at {offset} do not fit into its {}", self.bytes),
            )),
        }
    }

    pub(super) fn check_idle(&self) -> Result<()> {
        if self.block.in_flight.load(Ordering::Acquire) == 0 {
            return Ok(());
        }
        let problem = "in use by a submission: wait for that first";
        Err(Error::argument(format!("buffer '{}'", self.name), problem))
    }

    pub(super) fn block(&self) -> &Arc<Block> {
        &self.block
    }

    pub(super) fn raw(&self) -> vk::Buffer {
        self.block.raw
    }

    /// Byte offset in the block.
    pub(super) fn offset(&self) -> u64 {
        self.offset
    }

    pub(super) fn static_name(&self) -> &'static str {
        self.name
    }
}

impl std::fmt::Debug for Buffer {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Buffer('{}', {} bytes)", self.name, self.bytes)
    }
}
