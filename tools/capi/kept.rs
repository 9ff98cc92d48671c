//! What a renderer keeps from one recording for the next, so that this takes nothing from the heap.

use super::AshsplatHostBuffer;
use ashsplat::Result;
use ashsplat::ash::{vk, vk::Handle};
use ashsplat::scene::Gaussians;
use ashsplat::vk::{Buffer, Context};
use std::cell::{Cell, RefCell};
use std::ops::{Deref, DerefMut};

/// A mask that has not been used in so many recordings is let go. Slots take turns, each perhaps with masks of its own.
const IDLE_RECORDINGS: u64 = 64;

/// See the module.
#[derive(Default)]
pub(super) struct Kept {
    gaussians: RefCell<Vec<Gaussians>>,
    masks: RefCell<Vec<Mask>>,
    recordings: Cell<u64>,
}

/// A host's buffer, as adopted.
struct Mask {
    host: AshsplatHostBuffer,
    adopted: Buffer,
    last_used: u64,
}

impl Kept {
    /// A recording begins.
    pub fn begin(&self) {
        let now = self.recordings.get() + 1;
        self.recordings.set(now);
        self.masks.borrow_mut().retain(|mask| now - mask.last_used <= IDLE_RECORDINGS);
    }

    /// Arrays for the copy of an update. They keep their memory when they are dropped.
    pub fn gaussians(&self) -> Copy<'_> {
        Copy { own: self.gaussians.borrow_mut().pop().unwrap_or_default(), of: &self.gaussians }
    }

    /// A mask, adopted unless it has been.
    ///
    /// # Safety
    /// As [`Buffer::adopt`] says.
    pub unsafe fn mask(&self, context: &Context, host: AshsplatHostBuffer) -> Result<Buffer> {
        let (mut masks, now) = (self.masks.borrow_mut(), self.recordings.get());
        if let Some(mask) = masks.iter_mut().find(|mask| mask.host == host) {
            mask.last_used = now;
            return Ok(mask.adopted.clone());
        }
        let raw = vk::Buffer::from_raw(host.buffer);
        // SAFETY: as promised.
        let adopted = unsafe { Buffer::adopt(context, "selection", raw, host.offset, host.bytes) }?;
        masks.push(Mask { host, adopted: adopted.clone(), last_used: now });
        Ok(adopted)
    }
}

/// Gaussians that an update copies.
pub(super) struct Copy<'a> {
    own: Gaussians,
    of: &'a RefCell<Vec<Gaussians>>,
}

impl Deref for Copy<'_> {
    type Target = Gaussians;

    fn deref(&self) -> &Gaussians {
        &self.own
    }
}

impl DerefMut for Copy<'_> {
    fn deref_mut(&mut self) -> &mut Gaussians {
        &mut self.own
    }
}

impl Drop for Copy<'_> {
    fn drop(&mut self) {
        self.of.borrow_mut().push(std::mem::take(&mut self.own));
    }
}
