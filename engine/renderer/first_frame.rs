//! Frame slots that hold a host's first frame whole, before it is recorded.

use super::Renderer;
use super::check::check_capacity;
use super::record::{RecordedFrame, inputs_of};
use super::reservation::Reservation;
use super::slots::SlotReport;
use crate::error::{Error, Result};
use crate::forward::RenderSettings;

impl Renderer {
    /// As [`Renderer::reserve`], with room for this frame: without
    /// [`instances`](Reservation::instances) a reservation is an estimate, and a first frame that needs more
    /// lacks what lies farthest back. Counts what the frame needs, without its targets, occluder and updates.
    /// Where scenes are shown, hidden or cut in turn, give the frame that shows most. Submits to the context's queue, and waits.
    /// Returns what is reserved.
    ///
    /// # Errors
    /// As [`Renderer::reserve`] and [`Renderer::record`]; on a host's device that was given without a queue.
    pub fn reserve_for(&mut self, wanted: &Reservation, frame: &RecordedFrame<'_>) -> Result<Reservation> {
        let mut reserved = *wanted;
        self.reserve(&reserved)?;
        loop {
            let report = self.count(frame, &reserved)?;
            let grown = reserved.grown(&report);
            if grown == reserved {
                return Ok(reserved);
            }
            // The reserve may be what does not fit.
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

    /// Executes a frame in the first slot, which is free, up to its counts.
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
