//! What a training has memory for in advance: recorded steps, and Gaussians to come, which give way to a frame.

use super::model::Model;
use super::{Checkpoint, Trainer};
use crate::error::Result;
use crate::plan::{FrameCapacity, LaunchSizes, ScenePlan, frame_bytes, frame_fits_device};
use crate::planes;
use crate::renderer::State;

/// What is allocated in advance for recording steps: see [`Trainer::reserve_steps`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StepReservation {
    /// Steps that may be recorded before the first of them has finished. They share the same memory, except
    /// for a few words each.
    pub slots: u32,
    /// Least capacity in (tile, Gaussian) instances of a step; 0 for an estimate. [`Trainer::maintain`] grows it.
    pub instances: u32,
    /// Least capacity in visible Gaussians, those around a block among them; 0 for an estimate.
    pub visible: u32,
}

impl Default for StepReservation {
    fn default() -> Self {
        Self { slots: 2, instances: 0, visible: 0 }
    }
}

impl Trainer {
    /// Frees the reserve of Gaussians where that makes room for a frame. What is kept of each Gaussian goes through the host, for
    /// there is no memory for a second copy. Returns whether it was freed. Recorded steps have reserved what they need: while there
    /// are slots for them the reserve stays.
    ///
    /// # Errors
    /// When the memory does not suffice after all, because somebody else holds what was freed or takes it:
    /// [`Trainer::checkpoint`] then still has everything, and every later step is refused.
    pub(super) fn give_up_reserve(&mut self, needed: &State) -> Result<bool> {
        let scene = &self.state.model.scene;
        let plan = ScenePlan::new(self.context.limits(), scene.count, scene.plan.sh_degree)?;
        let smaller = (plan.chunks, plan.chunk_gaussians) != (scene.plan.chunks, scene.plan.chunk_gaussians);
        if !smaller || self.recording.has_slots() || !self.has_room_without_reserve(needed, &plan) {
            return Ok(false);
        }
        let kept = Box::new(self.checkpoint()?);
        // Until all of it is there again.
        self.state.broken = true;
        self.state.model.release();
        self.runner.forget();
        let rebuilt = self.rebuild(&kept, &plan);
        self.state.broken = rebuilt.is_err();
        self.state.rescued = rebuilt.is_err().then_some(kept);
        rebuilt.map(|()| true)
    }

    fn rebuild(&mut self, from: &Checkpoint, plan: &ScenePlan) -> Result<()> {
        let arena = ("scene", self.rows.planes());
        let scene = planes::upload(&self.context, arena, &from.gaussians, plan.capacity, plan.sh_degree)?;
        self.state.model = Model::new(&self.context, scene, &self.rows)?;
        self.restore_rows(from)
    }

    /// Whether the memory holds the frame beside planes of this plan, if nobody else holds the present ones.
    fn has_room_without_reserve(&self, needed: &State, plan: &ScenePlan) -> bool {
        let (context, present) = (&self.context, &self.state.model.scene.plan);
        let Some((limit, _)) = context.memory_limit() else { return false };
        let sizes = LaunchSizes::new(context.limits());
        let frame = FrameCapacity {
            gaussians: self.runner.gaussians_with(plan.capacity),
            visible: needed.visible_needed,
            instances: needed.all_instances(),
            blend_passes: needed.longest_tile.div_ceil(sizes.entries_per_pass).max(1),
            ..self.runner.capacity()
        };
        let freed = self.rows.bytes(present).device + self.runner.frame_bytes();
        let taken = self.rows.allocation_bytes(context, plan).device + frame_bytes(&frame, &sizes);
        frame_fits_device(context.limits(), &frame, &sizes)
            && context.held_bytes().saturating_sub(freed) + taken <= limit
    }
}
