//! A named range of device memory.

use super::context::Context;
use super::memory::{Block, MemoryKind, PLACEMENT_ALIGNMENT};
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

    /// A range of a host's buffer.
    ///
    /// # Errors
    /// [`Error::Argument`] for a null handle, no bytes, an offset that is no multiple of 256 or a size that
    /// is no multiple of 4; and in a context of our own that reads texels
    /// ([`ContextOptions::texels`](super::ContextOptions::texels)).
    ///
    /// # Safety
    /// - `raw` is of the context's device, bound to memory, has at least `offset + bytes` bytes and the
    ///   usages STORAGE_BUFFER, TRANSFER_SRC and TRANSFER_DST, and UNIFORM_BUFFER if a kernel reads it as a
    ///   uniform block;
    /// - it lives until the last recording that uses it has finished and the buffer and its clones are
    ///   dropped;
    /// - no two adopted buffers overlap.
    pub unsafe fn adopt(
        context: &Context,
        name: &'static str,
        raw: vk::Buffer,
        offset: u64,
        bytes: u64,
    ) -> Result<Self> {
        context.check_adoption()?;
        let bad = |problem: String| Err(Error::argument(format!("buffer '{name}'"), problem));
        if raw == vk::Buffer::null() {
            return bad("the handle is null".into());
        }
        if bytes == 0 || !bytes.is_multiple_of(4) || !offset.is_multiple_of(PLACEMENT_ALIGNMENT) {
            return bad(format!("{bytes} bytes at {offset} are no range of words at a multiple of 256"));
        }
        let end = offset.saturating_add(bytes);
        Ok(Self::new(Arc::new(Block::foreign(&context.0, raw, end)), offset, bytes, name))
    }

    /// Whether it belongs to this context's device.
    pub fn belongs_to(&self, context: &Context) -> bool {
        self.block.is_of(&context.0)
    }

    /// The Vulkan buffer, and the byte offset of this range in it.
    pub fn handle(&self) -> (vk::Buffer, u64) {
        (self.raw(), self.offset)
    }

    /// Its size.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// The name from its request.
    pub fn name(&self) -> &str {
        self.name
    }

    /// A part of the buffer under the same name.
    ///
    /// # Panics
    /// If the part does not lie inside.
    pub fn range(&self, offset: u64, bytes: u64) -> Buffer {
        let inside = offset.checked_add(bytes).is_some_and(|end| end <= self.bytes);
        assert!(inside, "range {offset}+{bytes} lies outside of '{}' of {} bytes", self.name, self.bytes);
        Buffer { offset: self.offset + offset, bytes, ..self.clone() }
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
    /// As [`Buffer::write`].
    pub fn read(&self, offset: u64, bytes: &mut [u8]) -> Result<()> {
        self.check_host("read", offset, bytes.len())?;
        self.block.read_mapped(self.offset + offset, bytes);
        Ok(())
    }

    fn check_host(&self, done: &str, offset: u64, bytes: usize) -> Result<()> {
        let name = format!("buffer '{}'", self.name);
        if self.block.kind != MemoryKind::HostVisible {
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

    /// The guard bands before and after the buffer, which has `bytes` bytes.
    pub(super) fn guards(&self, bytes: u64) -> [Buffer; 2] {
        [self.offset - bytes, self.offset + self.bytes].map(|offset| Buffer { offset, bytes, ..self.clone() })
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
