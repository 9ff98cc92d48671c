//! Memory that a renderer keeps between recordings, so that recording allocates nothing on the heap.

use super::AshsplatHostBuffer;
use ashsplat::Result;
use ashsplat::ash::{vk, vk::Handle};
use ashsplat::scene::Gaussians;
use ashsplat::vk::{Buffer, Context};
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
pub(super) struct RecordingCache {
    /// Arrays for updates, by the update's index within a recording, with the last recording that used them.
    copies: Vec<(Gaussians, u64)>,
    /// Number of updates in this recording so far.
    updates: usize,
    /// Adopted masks, with the last recording that used them.
    masks: HashMap<AshsplatHostBuffer, (Buffer, u64)>,
    recordings: u64,
}

impl RecordingCache {
    /// Begins a recording.
    pub fn begin(&mut self) {
        self.recordings += 1;
        self.updates = 0;
        let now = self.recordings;
        if now.is_multiple_of(IDLE_RECORDINGS) {
            let is_used = |last_used: u64| now - last_used <= IDLE_RECORDINGS;
            self.masks.retain(|_, (_, last_used)| is_used(*last_used));
            let idle = self.copies.iter_mut().filter(|copy| !is_used(copy.1));
            idle.for_each(|copy| copy.0 = Gaussians::default());
        }
    }

    /// Arrays for the Gaussians of the recording's next update.
    pub fn next_copy(&mut self) -> &mut Gaussians {
        let place = self.updates;
        self.updates += 1;
        if self.copies.len() <= place {
            self.copies.resize(place + 1, Default::default());
        }
        let (own, last_used) = &mut self.copies[place];
        *last_used = self.recordings;
        own
    }

    /// Copied Gaussians of the recording's updates, in their order.
    pub fn copies(&self) -> impl Iterator<Item = &Gaussians> {
        self.copies.iter().map(|(own, _)| own)
    }

    /// Adopts a mask on first use.
    ///
    /// # Safety
    /// The buffer meets the requirements of [`Buffer::adopt`] as long as recordings use it. Afterwards only its handle is kept,
    /// and never used with the device: contexts in which views are made of buffers refuse adopted ones.
    pub unsafe fn adopt(&mut self, context: &Context, host: AshsplatHostBuffer) -> Result<()> {
        if let Some((_, last_used)) = self.masks.get_mut(&host) {
            *last_used = self.recordings;
            return Ok(());
        }
        let raw = vk::Buffer::from_raw(host.buffer);
        // SAFETY: as promised.
        let adopted = unsafe { Buffer::adopt(context, "selection", raw, host.offset, host.bytes) }?;
        self.masks.insert(host, (adopted, self.recordings));
        Ok(())
    }

    /// Returns an adopted mask.
    pub fn mask(&self, host: &AshsplatHostBuffer) -> Option<&Buffer> {
        self.masks.get(host).map(|(adopted, _)| adopted)
    }
}
