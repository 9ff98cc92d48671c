//! Memory reserved in advance: for recorded steps, and for future Gaussians. The latter gives way to a frame.

use super::model::Model;
use super::{Checkpoint, Trainer};
use crate::error::Result;
use crate::plan::{FrameCapacity, LaunchSizes, ScenePlan, frame_bytes, frame_fits_device};
use crate::planes;
use crate::renderer::State;

/// Buffers to allocate in advance for recorded steps: see [`Trainer::reserve_steps`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StepReservation {
    /// Number of steps that may be recorded before the first of them has finished. They share the same memory, except for a few
    /// words each.
    pub slots: u32,
    /// Minimum capacity in (tile, Gaussian) instances of a step; 0 for an estimate. [`Trainer::maintain`] grows it.
    pub instances: u32,
    /// Minimum capacity in visible Gaussians, including frozen ones; 0 for an estimate.
    pub visible: u32,
}

impl Default for StepReservation {
    fn default() -> Self {
        Self { slots: 2, instances: 0, visible: 0 }
    }
}

impl Trainer {
    /// Frees the reserve of Gaussians if that makes enough memory for a frame. Returns true if it was freed. The rows move
    /// through the host, because memory does not hold a second copy. While there are slots for recorded steps, the reserve
    /// stays.
    ///
    /// # Errors
    /// When memory does not suffice after all, because another user holds or takes the freed part. [`Trainer::checkpoint`] then
    /// still returns the whole state, and every later step is refused.
    pub(super) fn give_up_reserve(&mut self, needed: &State) -> Result<bool> {
        let scene = &self.state.model.scene;
        let plan = ScenePlan::new(self.context.limits(), scene.count, scene.plan.sh_degree)?;
        let smaller = (plan.chunks, plan.chunk_gaussians) != (scene.plan.chunks, scene.plan.chunk_gaussians);
        if !smaller || self.recording.has_slots() || !self.has_room_without_reserve(needed, &plan) {
            return Ok(false);
        }
        let kept = Box::new(self.checkpoint()?);
        // The state is incomplete until the rebuild succeeds.
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

    /// True if memory holds the frame beside planes of this plan, once the present planes are freed.
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
