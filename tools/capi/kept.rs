//! Memory that a renderer keeps between recordings, so that recording allocates nothing on the heap.

use super::AshsplatHostBuffer;
use ashsplat::Result;
use ashsplat::ash::{vk, vk::Handle};
use ashsplat::scene::Gaussians;
use ashsplat::vk::{Buffer, Context};
use std::cell::{Cell, Ref, RefCell};
use std::collections::HashMap;

/// Arena for the lists of a recording. Another recording of the same size allocates nothing on the heap.
pub(super) type Scratch = bumpalo::Bump;

/// A list in the arena.
pub(super) type List<'b, T> = bumpalo::collections::Vec<'b, T>;

/// Collects an iterator's values, up to its first error.
pub(super) fn collected<T>(
    values: impl Iterator<Item = Result<T>>,
    scratch: &Scratch,
) -> Result<List<'_, T>> {
    let mut all = List::with_capacity_in(values.size_hint().0, scratch);
    for value in values {
        all.push(value?);
    }
    Ok(all)
}

/// Objects unused for this many recordings are freed. Slots take turns, perhaps with their own masks and updates.
const IDLE_RECORDINGS: u64 = 64;

#[derive(Default)]
pub(super) struct Kept {
    /// Arrays for updates, by the update's index within a recording, with the last recording that used them.
    copies: RefCell<Vec<(Gaussians, u64)>>,
    /// Number of updates in this recording so far.
    updates: Cell<usize>,
    /// Adopted masks, with the last recording that used them.
    masks: RefCell<HashMap<AshsplatHostBuffer, (Buffer, u64)>>,
    recordings: Cell<u64>,
}

impl Kept {
    /// Begins a recording.
    pub fn begin(&self) {
        let now = self.recordings.get() + 1;
        self.recordings.set(now);
        self.updates.set(0);
        if now.is_multiple_of(IDLE_RECORDINGS) {
            let is_used = |last_used: u64| now - last_used <= IDLE_RECORDINGS;
            self.masks.borrow_mut().retain(|_, (_, last_used)| is_used(*last_used));
            let mut copies = self.copies.borrow_mut();
            copies.iter_mut().filter(|copy| !is_used(copy.1)).for_each(|copy| copy.0 = Gaussians::default());
        }
    }

    /// Copies Gaussians into the arrays for the recording's next update. Returns their place among the copies.
    pub fn copy(&self, copy: impl FnOnce(&mut Gaussians) -> Result<()>) -> Result<usize> {
        let place = self.updates.replace(self.updates.get() + 1);
        let mut copies = self.copies.borrow_mut();
        if copies.len() <= place {
            copies.resize(place + 1, Default::default());
        }
        let (own, last_used) = &mut copies[place];
        *last_used = self.recordings.get();
        copy(own).map(|()| place)
    }

    /// Copied Gaussians of all updates.
    pub fn copies(&self) -> Ref<'_, Vec<(Gaussians, u64)>> {
        self.copies.borrow()
    }

    /// Returns an adopted mask; adopts it on first use.
    ///
    /// # Safety
    /// The buffer meets the requirements of [`Buffer::adopt`] as long as recordings use it. Afterwards only its handle is kept,
    /// and never used with the device: contexts in which views are made of buffers refuse adopted ones.
    pub unsafe fn mask(&self, context: &Context, host: AshsplatHostBuffer) -> Result<Buffer> {
        let (mut masks, now) = (self.masks.borrow_mut(), self.recordings.get());
        if let Some((adopted, last_used)) = masks.get_mut(&host) {
            *last_used = now;
            return Ok(adopted.clone());
        }
        let raw = vk::Buffer::from_raw(host.buffer);
        // SAFETY: as promised.
        let adopted = unsafe { Buffer::adopt(context, "selection", raw, host.offset, host.bytes) }?;
        masks.insert(host, (adopted.clone(), now));
        Ok(adopted)
    }
}
