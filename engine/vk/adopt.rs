//! Adopts buffers of a host.

use super::buffer::Buffer;
use super::context::Context;
use super::memory::{Block, PLACEMENT_ALIGNMENT, SMALLEST_BUFFER, pack};
use crate::{Error, Result};
use ash::vk;
use std::sync::Arc;

impl Buffer {
    /// Adopts a range of a host's buffer.
    ///
    /// # Errors
    /// [`Error::Argument`] for a null handle, no bytes, an offset that is no multiple of 256 or a size that is no multiple
    /// of 4. Also if the context opened its own device and reads texels
    /// ([`ContextOptions::texels`](super::ContextOptions::texels)).
    ///
    /// # Safety
    /// - `raw` belongs to the context's device, is bound to memory and has at least `offset + bytes` bytes;
    /// - it has the usages STORAGE_BUFFER, TRANSFER_SRC and TRANSFER_DST, and UNIFORM_BUFFER if a kernel reads it as a
    ///   uniform block;
    /// - it lives until the last recording that uses it has finished, and the buffer and its clones are dropped;
    /// - no two adopted buffers overlap.
    pub unsafe fn adopt(
        context: &Context,
        name: &'static str,
        raw: vk::Buffer,
        offset: u64,
        bytes: u64,
    ) -> Result<Self> {
        context.device.check_adoption()?;
        let bad = |problem: String| Err(Error::argument(format!("buffer '{name}'"), problem));
        if raw == vk::Buffer::null() {
            return bad("the handle is null".into());
        }
        if bytes == 0 || !bytes.is_multiple_of(4) || !offset.is_multiple_of(PLACEMENT_ALIGNMENT) {
            return bad(format!("{bytes} bytes at {offset} are no range of words at a multiple of 256"));
        }
        let end = offset.saturating_add(bytes);
        Ok(Self::new(Arc::new(Block::foreign(&context.device, raw, end)), offset, bytes, name))
    }

    /// Returns the same range for another context on the same VkDevice; it keeps the memory alive. Both contexts then use
    /// one buffer, and the host orders the uses: within one queue they are in order, across queues by semaphores.
    ///
    /// # Errors
    /// [`Error::Argument`] for a context on another device, or whose queues are of another family than the one that owns
    /// the buffer. Also the errors of [`Buffer::adopt`].
    pub fn in_context(&self, context: &Context) -> Result<Self> {
        if self.belongs_to(context) {
            return Ok(self.clone());
        }
        let bad = |problem: String| Err(Error::argument(format!("buffer '{}'", self.name()), problem));
        let (own, other) = (self.block().device(), &context.device);
        if own.device.handle() != other.device.handle() {
            return bad("it belongs to another device".into());
        }
        if own.queue_family != other.queue_family {
            return bad(format!(
                "queue family {} owns it, the context's queues are of family {}: a context of that family needs one of its own",
                own.queue_family, other.queue_family
            ));
        }
        other.check_adoption()?;
        let block = Arc::new(Block::lent(other, self.block()));
        Ok(Self::new(block, self.offset(), self.bytes(), self.static_name()))
    }

    /// Splits the buffer into buffers of these names and sizes, bytes, placed by [`pack`].
    ///
    /// # Panics
    /// When they do not fit.
    pub(crate) fn split(&self, requests: &[(&'static str, u64)]) -> Vec<Self> {
        let sizes: Vec<u64> = requests.iter().map(|(_, bytes)| *bytes).collect();
        let Ok(packing) = pack(&sizes, u64::MAX) else { unreachable!("no size is above the largest") };
        let places = requests.iter().zip(packing.places);
        let part = |(&(name, bytes), (_, offset)): (&(&'static str, u64), (usize, u64))| {
            let part = self.range(offset, bytes.max(SMALLEST_BUFFER).next_multiple_of(4));
            Self::new(part.block().clone(), part.offset(), part.bytes(), name)
        };
        places.map(part).collect()
    }

    /// True if it belongs to this context's device.
    pub fn belongs_to(&self, context: &Context) -> bool {
        self.block().is_of(&context.device)
    }
}
