//! Reserves frame slots that are large enough for a host's first frame, before it is recorded.

use super::Renderer;
use super::check::check_capacity;
use super::record::{RecordedFrame, inputs_of};
use super::reservation::Reservation;
use super::slots::SlotReport;
use crate::error::{Error, Result};
use crate::forward::RenderSettings;

impl Renderer {
    /// Same as [`Renderer::reserve`], but large enough for this frame. Without [`instances`](Reservation::instances) a
    /// reservation is an estimate, and a first frame that needs more lacks its farthest Gaussians. Counts the needs of the
    /// frame, without its targets, occluder and updates. If scenes are shown, hidden or cut at different times, give the
    /// frame that shows most. Submits to the context's queue, and waits. Returns the reservation.
    ///
    /// # Errors
    /// Errors of [`Renderer::reserve`] and [`Renderer::record`]; [`Error::Argument`] for a host's device without a queue.
    pub fn reserve_for(&mut self, wanted: &Reservation, frame: &RecordedFrame<'_>) -> Result<Reservation> {
        let mut reserved = *wanted;
        self.reserve(&reserved)?;
        loop {
            let report = self.count(frame, &reserved)?;
            let grown = reserved.grown(&report);
            if grown == reserved {
                return Ok(reserved);
            }
            // The reserve of half may be what does not fit.
            let exact = Reservation { instances: grown.instances.min(report.instances_needed), ..grown };
            reserved = match self.reserve(&grown) {
                Err(Error::TooLarge { .. } | Error::Vulkan { .. }) if exact != grown => {
                    self.reserve(&exact)?;
                    exact
                }
                done => done.map(|()| grown)?,
            };
        }
    }

    /// Runs a frame, up to its counts, in the first slot, which must be free.
    fn count(&mut self, frame: &RecordedFrame<'_>, reserved: &Reservation) -> Result<SlotReport> {
        let mut placed = Vec::new();
        self.check_frame((frame, &[]), reserved, &mut placed)?;
        let forward = &self.runner.forward;
        let slot = self.slots.get(0)?;
        check_capacity((frame, &placed), &slot.upcoming().capacity, reserved)?;
        let settings = RenderSettings { inverse_depth: false, ..*frame.settings };
        let inputs = inputs_of(&placed, &slot.memory, &settings);
        self.context.run("count", |r| {
            forward.record(r, &inputs);
            r.barrier();
            slot.record_counts(r, 0);
            Ok(())
        })?;
        slot.counts(&forward.sizes, 1)
    }
}
