//! For tests: positions of the guard bands around a buffer.

use super::buffer::Buffer;
use super::memory::PLACEMENT_ALIGNMENT;
use std::sync::PoisonError;

/// Bytes of the guard band before and after each buffer, which must not be written; a multiple of the buffers' alignment.
/// The writes of one excess workgroup, of 256 invocations with a vec4 each, end within it.
pub(super) const GUARD_BYTES: u64 = 16 * PLACEMENT_ALIGNMENT;

impl Buffer {
    /// Returns the bands of `bytes` bytes before and after the buffer.
    pub(super) fn guards(&self, bytes: u64) -> [Buffer; 2] {
        let (start, end) = (self.offset(), self.offset() + self.bytes());
        [start - bytes, end]
            .map(|offset| Buffer::new(self.block().clone(), offset, bytes, self.static_name()))
    }

    /// Returns the bytes of the band behind the buffer, if the buffer ends where a guarded one does.
    pub(super) fn guard_behind(&self) -> u64 {
        let end = self.offset() + self.bytes();
        let guarded = self.block().guarded.lock().unwrap_or_else(PoisonError::into_inner);
        if guarded.iter().any(|(offset, bytes, _)| offset + bytes == end) { GUARD_BYTES } else { 0 }
    }
}
