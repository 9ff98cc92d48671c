//! For tests: guard bands around every buffer, which detect writes outside it.

use super::buffer::Buffer;
use super::context::Context;
use super::guard_bands::GUARD_BYTES;
use crate::Result;
use std::sync::{Arc, PoisonError};

/// Content of the guard bands.
const GUARD_PATTERN: u8 = 0xA5;

impl Context {
    /// Fills the guard bands of new buffers with their pattern, if there are any.
    pub(super) fn raise_guards(&self, buffers: &[Buffer]) -> Result<()> {
        if !self.device.guard_bands {
            return Ok(());
        }
        for buffer in buffers {
            for band in buffer.guards(GUARD_BYTES) {
                self.upload(&band, &[GUARD_PATTERN; GUARD_BYTES as usize])?;
            }
        }
        let mut blocks = self.logs.guarded.lock().unwrap_or_else(PoisonError::into_inner);
        blocks.retain(|block| block.strong_count() > 0);
        for buffer in buffers {
            let mut guarded = buffer.block().guarded.lock().unwrap_or_else(PoisonError::into_inner);
            if guarded.is_empty() {
                blocks.push(Arc::downgrade(buffer.block()));
            }
            guarded.push((buffer.offset(), buffer.bytes(), buffer.static_name()));
        }
        Ok(())
    }

    /// For tests of the guards: writes directly behind a buffer.
    ///
    /// # Errors
    /// When the band cannot be written.
    pub fn breach_guard(&self, buffer: &Buffer) -> Result<()> {
        let [_, behind] = buffer.guards(if self.device.guard_bands { GUARD_BYTES } else { 0 });
        self.upload(&behind, &vec![0; behind.bytes().min(4) as usize])
    }

    /// Returns the names of living buffers with writes outside them; see [`super::ContextOptions::guard_bands`].
    ///
    /// # Errors
    /// When a band cannot be read.
    pub fn breached_guards(&self) -> Result<Vec<&'static str>> {
        let blocks = self.logs.guarded.lock().unwrap_or_else(PoisonError::into_inner).clone();
        let mut breached = Vec::new();
        for block in blocks.iter().filter_map(std::sync::Weak::upgrade) {
            let guarded = block.guarded.lock().unwrap_or_else(PoisonError::into_inner).clone();
            for (offset, bytes, name) in guarded {
                for band in Buffer::new(block.clone(), offset, bytes, name).guards(GUARD_BYTES) {
                    if self.download(&band)?.iter().any(|&byte| byte != GUARD_PATTERN) {
                        breached.push(name);
                    }
                }
            }
        }
        Ok(breached)
    }
}
