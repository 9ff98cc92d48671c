//! Recording state of a slot that belongs to a renderer or a trainer.

use super::foreign::RecordSlot;
use crate::Result;

/// Recording state of a slot that belongs to a renderer or a trainer. It is not a `&mut RecordSlot`: a caller could swap
/// that for another slot, which does not track the frame in flight.
pub struct SlotRecording<'a>(&'a mut RecordSlot);

impl<'a> SlotRecording<'a> {
    pub(crate) fn new(slot: &'a mut RecordSlot) -> Self {
        Self(slot)
    }

    /// See [`RecordSlot::is_recorded`].
    pub fn is_recorded(&self) -> bool {
        self.0.is_recorded()
    }

    /// See [`RecordSlot::finished`].
    ///
    /// # Errors
    /// When the device is lost.
    pub fn finished(&self) -> Result<bool> {
        self.0.finished()
    }

    /// See [`RecordSlot::discard`].
    ///
    /// # Safety
    /// Same as [`RecordSlot::discard`].
    pub unsafe fn discard(&mut self) {
        // SAFETY: as promised.
        unsafe { self.0.discard() }
    }
}
