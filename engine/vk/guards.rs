//! For tests: guard bands around every buffer, which detect writes outside of it.

use super::buffer::Buffer;
use super::context::{Context, Inner};
use super::memory::{Block, PLACEMENT_ALIGNMENT};
use crate::Result;
use std::sync::{Arc, PoisonError, Weak};

/// Bytes before and after each buffer that must not be written; a multiple of the buffers' alignment. The
/// writes of one excess workgroup, of 256 invocations with a vec4 each, end within them.
pub(super) const GUARD_BYTES: u64 = 16 * PLACEMENT_ALIGNMENT;
/// Content of the guard bands.
const GUARD_PATTERN: u8 = 0xA5;
/// A block, and the offset, size and name of a buffer in it.
pub(super) type Guarded = (Weak<Block>, u64, u64, &'static str);

impl Context {
    /// Fills the guard bands of buffers with their pattern.
    pub(super) fn raise_guards(&self, buffers: &[Buffer]) -> Result<()> {
        for buffer in buffers {
            for band in buffer.guards(GUARD_BYTES) {
                self.upload(&band, &[GUARD_PATTERN; GUARD_BYTES as usize])?;
            }
        }
        let mut guarded = self.0.guarded.lock().unwrap_or_else(PoisonError::into_inner);
        guarded.retain(|(block, ..)| block.strong_count() > 0);
        let places =
            buffers.iter().map(|b| (Arc::downgrade(b.block()), b.offset(), b.bytes(), b.static_name()));
        guarded.extend(places);
        Ok(())
    }
}

impl Inner {
    /// Bytes after a buffer that are bound with it. Drivers drop writes outside of the bound range, so that
    /// without them no breach would be visible.
    pub(super) fn guard_behind(&self, buffer: &Buffer) -> u64 {
        if !self.guard_bands {
            return 0;
        }
        let end = buffer.offset() + buffer.bytes();
        let guarded = self.guarded.lock().unwrap_or_else(PoisonError::into_inner);
        let ends = |(block, offset, bytes, _): &Guarded| {
            offset + bytes == end && std::ptr::eq(block.as_ptr(), Arc::as_ptr(buffer.block()))
        };
        if guarded.iter().any(ends) { GUARD_BYTES } else { 0 }
    }
}

impl Context {
    /// For tests of the guards: writes directly after a buffer.
    ///
    /// # Errors
    /// When the band cannot be written.
    pub fn breach_guard(&self, buffer: &Buffer) -> Result<()> {
        let [_, behind] = buffer.guards(if self.0.guard_bands { GUARD_BYTES } else { 0 });
        self.upload(&behind, &vec![0; behind.bytes().min(4) as usize])
    }

    /// The names of living buffers with writes outside of them; see [`super::ContextOptions::guard_bands`].
    ///
    /// # Errors
    /// When a band cannot be read.
    pub fn breached_guards(&self) -> Result<Vec<&'static str>> {
        let guarded = self.0.guarded.lock().unwrap_or_else(PoisonError::into_inner).clone();
        let mut breached = Vec::new();
        for (block, offset, bytes, name) in guarded {
            let Some(block) = block.upgrade() else { continue };
            for band in Buffer::new(block, offset, bytes, name).guards(GUARD_BYTES) {
                if self.download(&band)?.iter().any(|&byte| byte != GUARD_PATTERN) {
                    breached.push(name);
                }
            }
        }
        Ok(breached)
    }
}
