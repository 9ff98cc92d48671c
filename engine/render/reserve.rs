//! Reserves frame slots, and answers a host's queries about them.

use super::forward::Forward;
use super::renderer::Renderer;
use super::reservation::{Reservation, SlotReport};
use super::slots::{Slot, SlotLayout};
use crate::error::{Error, Result};
use crate::passes::compose::Compose;
use crate::vk::{Buffer, Context, KernelJob, SlotRecording};

impl Renderer {
    /// Allocates frame slots and builds all kernels that frames of this kind need. Replaces the previous
    /// slots, whose command buffers must have finished
    /// ([`Context::adopt_commands`](crate::vk::Context::adopt_commands)). Neither submits nor waits.
    ///
    /// # Errors
    /// [`Error::Argument`] for an invalid reservation or while a slot is in flight. [`Error::TooLarge`] if the reservation
    /// exceeds the device; it names the field. Memory or device failures. The slots stay as before, except after a lack of
    /// device or host memory: then none is reserved.
    pub fn reserve(&mut self, reservation: &Reservation) -> Result<()> {
        self.reserve_by(reservation, None)
    }

    /// Same as [`Renderer::reserve`], but all device memory comes from one block of the host ([`Buffer::adopt`]), of at
    /// least [`Renderer::reservation_bytes`]. In addition, each slot allocates [`Reservation::staging_bytes`] and 36
    /// host-readable bytes for each view. The block has the usages STORAGE_BUFFER, UNIFORM_BUFFER, INDIRECT_BUFFER,
    /// TRANSFER_SRC and TRANSFER_DST.
    ///
    /// # Errors
    /// Same as [`Renderer::reserve`]; also for a block of another context, or one that is too small.
    pub fn reserve_in(&mut self, reservation: &Reservation, block: &Buffer) -> Result<()> {
        self.reserve_by(reservation, Some(block))
    }

    fn reserve_by(&mut self, reservation: &Reservation, block: Option<&Buffer>) -> Result<()> {
        // Refuses before kernels are built, which may take seconds.
        reservation.check()?;
        self.slots.check_free()?;
        let context = self.context.clone();
        let layout = SlotLayout::new(&context, &self.runner.forward.sizes, reservation, block)?;
        self.prepare(reservation)?;
        self.slots.reserve(&layout)
    }

    /// Same as [`Renderer::reserve`], but allowed while frames are in flight, and without waiting. Every slot switches to
    /// the new memory with its next recording; with [`Reservation::images_only`] also when it is released. The old memory
    /// is freed when the last slot has switched, so until then both exist. The numbers of slots and of views must stay the
    /// same. An unchanged reservation allocates nothing; a smaller one frees memory.
    /// # Errors
    /// Same as [`Renderer::reserve`]; [`Error::Argument`] without slots, or for another number of slots or views. The slots
    /// then stay as before.
    pub fn grow(&mut self, reservation: &Reservation) -> Result<()> {
        self.grow_by(reservation, None)
    }

    /// Same as [`Renderer::grow`], but in a block of the host, as for [`Renderer::reserve_in`]. The old block is unused
    /// once every slot has switched to the new one, and earlier frames have finished.
    ///
    /// # Errors
    /// Same as [`Renderer::grow`] and [`Renderer::reserve_in`].
    pub fn grow_in(&mut self, reservation: &Reservation, block: &Buffer) -> Result<()> {
        self.grow_by(reservation, Some(block))
    }

    fn grow_by(&mut self, reservation: &Reservation, block: Option<&Buffer>) -> Result<()> {
        reservation.check()?;
        self.slots.check_growth(reservation)?;
        if block.is_none() && self.slots.reserved == Some(*reservation) {
            return self.prepare(reservation);
        }
        let context = self.context.clone();
        let layout = SlotLayout::new(&context, &self.runner.forward.sizes, reservation, block)?;
        self.prepare(reservation)?;
        self.slots.grow(&layout)
    }

    /// Returns the bytes of a reservation's block for [`Renderer::reserve_in`].
    ///
    /// # Errors
    /// Same as [`Renderer::reserve`], without allocating anything.
    pub fn reservation_bytes(&self, reservation: &Reservation) -> Result<u64> {
        let layout = SlotLayout::new(&self.context, &self.runner.forward.sizes, reservation, None)?;
        Ok(layout.block_bytes())
    }

    /// Returns the kernels that [`Renderer::new`] and [`Renderer::reserve`] build. A host can build them ahead on its own
    /// threads; both then build none. Assumes the device's default form of blending.
    ///
    /// # Errors
    /// [`Error::Argument`] for an invalid reservation; [`Error::TooLarge`] for kernels that exceed the device.
    pub fn kernel_jobs(context: &Context, reservation: &Reservation) -> Result<Vec<KernelJob>> {
        reservation.check()?;
        context.kernel_jobs(|context| {
            prepare_frames(&mut Forward::new(context)?, reservation)?;
            Compose::new(context)?.prepare(context, reservation.outputs())
        })
    }

    fn prepare(&mut self, reservation: &Reservation) -> Result<()> {
        let compose = match &mut self.compose {
            Some(compose) => compose,
            none => none.insert(Compose::new(&self.context)?),
        };
        compose.prepare(&self.context, reservation.outputs())?;
        prepare_frames(&mut self.runner.forward, reservation)?;
        self.slots.blending = self.blending();
        Ok(())
    }

    /// Returns the report of a slot's last frame. None while it is in flight, or without a frame. Never waits, except on
    /// llvmpipe, where reading timestamps waits for the whole device
    /// ([`ContextOptions::timestamps`](crate::vk::ContextOptions::timestamps)).
    ///
    /// # Errors
    /// [`Error::Argument`] for a slot that is not reserved; when the device is lost.
    pub fn slot_report(&mut self, slot: u32) -> Result<Option<SlotReport>> {
        let sizes = self.runner.forward.sizes;
        self.slots.get(slot)?.report(&sizes)
    }

    /// True if the last frame of a slot has finished. Never waits. Commands that the host recorded after the frame may
    /// still run: see [`Context::adopt_commands`](crate::vk::Context::adopt_commands).
    ///
    /// # Errors
    /// Same as [`Renderer::slot_report`].
    pub fn slot_finished(&mut self, slot: u32) -> Result<bool> {
        self.slots.get(slot)?.recording.finished()
    }

    /// Releases the resources of a slot's last frame, once its command buffer has finished. Scenes and image views dropped
    /// meanwhile are destroyed now, not at the slot's next recording.
    ///
    /// # Errors
    /// [`Error::Argument`] for a slot that is not reserved or still in flight.
    pub fn release_slot(&mut self, slot: u32) -> Result<()> {
        let slot = self.slots.get(slot)?;
        slot.recording.release()?;
        // The host may still read pixels of the last frame.
        if !slot.memory.keeps_pixels {
            slot.take_over();
        }
        Ok(())
    }

    /// Returns the buffer that [`Target::Slot`](super::Target::Slot) fills. Per pixel, row by row, f32: premultiplied r, g,
    /// b (display-encoded, as trained) and transmittance. Usable as a storage buffer and a source of transfers.
    /// [`Renderer::reserve`] replaces it; after [`Renderer::grow`], the slot's next recording replaces it.
    ///
    /// # Errors
    /// [`Error::Argument`] for a slot that is not reserved, or with [`Reservation::images_only`].
    pub fn slot_pixels(&mut self, slot: u32) -> Result<Buffer> {
        Ok(self.slot_with_pixels(slot)?.memory.frame.accumulated.clone())
    }

    /// Returns the buffer of [`RenderSettings::inverse_depth`](crate::RenderSettings::inverse_depth): the sum of weights /
    /// z per pixel, row by row, f32. With an expected depth ([`RecordedFrame::depth`](super::RecordedFrame::depth)) it
    /// holds the sum of weights * z. Otherwise same as [`Renderer::slot_pixels`].
    ///
    /// # Errors
    /// Same as [`Renderer::slot_pixels`].
    pub fn slot_inverse_depth(&mut self, slot: u32) -> Result<Buffer> {
        let memory = &self.slot_with_pixels(slot)?.memory;
        match memory.keeps_depth {
            true => Ok(memory.frame.depth_sums.clone()),
            false => Err(Error::argument("inverse_depth", "not reserved")),
        }
    }

    /// Returns the slot's recording state, for a host that has discarded its command buffer or caught a panic: see
    /// [`SlotRecording::discard`].
    ///
    /// # Errors
    /// [`Error::Argument`] for a slot that is not reserved.
    pub fn slot_recording(&mut self, slot: u32) -> Result<SlotRecording<'_>> {
        Ok(SlotRecording::new(&mut self.slots.get(slot)?.recording))
    }

    fn slot_with_pixels(&mut self, slot: u32) -> Result<&mut Slot> {
        let slot = self.slots.get(slot)?;
        match slot.memory.keeps_pixels {
            true => Ok(slot),
            false => Err(Error::argument("images_only", "is reserved: slots have no pixels of their own")),
        }
    }
}

fn prepare_frames(forward: &mut Forward, reservation: &Reservation) -> Result<()> {
    for variant in reservation.scene_variants() {
        for sh_degree in 0..=reservation.sh_degree.min(3) {
            forward.prepare_scenes(sh_degree, variant, reservation.has_batches())?;
        }
    }
    reservation.blend_variants().into_iter().try_for_each(|variant| forward.prepare_blend(variant))
}
