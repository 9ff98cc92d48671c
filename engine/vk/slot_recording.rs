//! The state of a recording whose slot belongs to a renderer or a trainer.

use super::foreign::RecordSlot;
use crate::Result;

/// The recording state of a slot that belongs to a renderer or a trainer. It is no `&mut RecordSlot`: such a
/// one could be exchanged for another slot, which knows nothing of the frame in flight.
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
    /// As there.
    pub unsafe fn discard(&mut self) {
        // SAFETY: as promised.
        unsafe { self.0.discard() }
    }
}
