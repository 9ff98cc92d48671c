//! What a training run needs of memory, before it is asked for.

use super::LossScratch;
use super::checkpoint::Room;
use super::photos::PhotoBytes;
use crate::error::{Error, Result};
use crate::loss;
use crate::plan::{
    FrameCapacity, LaunchSizes, ScenePlan, check_grids, frame_bytes, frame_requests, initial_instances,
    max_trained_gaussians, max_trained_instances,
};
use crate::renderer::FrameStore;
use crate::scene::Camera;
use crate::vk::Context;

/// Parameters, two moments, and the set that densification gathers into.
const SETS: u64 = 4;
/// Bytes of a Gaussian's statistics.
const STATISTICS_BYTES: u64 = 8;

/// Bytes of the planes and statistics of a plan.
pub(super) fn sets_bytes(plan: &ScenePlan) -> u64 {
    SETS * plan.chunk_bytes() * u64::from(plan.chunks) + STATISTICS_BYTES * u64::from(plan.capacity)
}

/// The widest and the highest of the views, px: a frame's buffers serve all of them.
pub(super) fn largest_sides(cameras: &[Camera]) -> (u32, u32) {
    let largest = |side: fn(&Camera) -> u32| cameras.iter().map(side).max().unwrap_or(0);
    (largest(|camera| camera.width), largest(|camera| camera.height))
}

/// What a training run is going to have, before anything is allocated.
pub(super) struct Before<'a> {
    pub cameras: &'a [Camera],
    pub photo_bytes: PhotoBytes,
    /// Gaussians to start from.
    pub count: u32,
    pub sh_degree: u32,
}

impl Before<'_> {
    /// Bytes of all buffers but the photographs': as they are allocated by the end of the first iteration that has room.
    fn buffer_bytes(&self, context: &Context, plan: &ScenePlan, frame: Option<FrameCapacity>) -> u64 {
        let limits = context.limits();
        let bytes = |requests: &[(&'static str, u64)]| context.allocation_bytes(requests);
        let planes = bytes(&vec![("planes", plan.chunk_bytes()); plan.chunks as usize]);
        let statistics = bytes(&[("statistics", STATISTICS_BYTES * u64::from(plan.capacity))]);
        let scratch = loss::scratch_requests(limits, self.cameras.iter().map(|c| (c.width, c.height)));
        // The counts of training's frames and of pictures.
        let readback = 2 * bytes(&FrameStore::READBACK) + bytes(&LossScratch::READBACK);
        let frame = frame.map_or(0, |frame| bytes(&frame_requests(&frame, &LaunchSizes::new(limits))));
        SETS * planes + statistics + bytes(&LossScratch::with_losses(scratch)) + readback + frame
    }

    /// The first frame for so many Gaussians, with room for all views.
    fn first_frame(&self, context: &Context, gaussians: u32) -> FrameCapacity {
        let (width, height) = largest_sides(self.cameras);
        let instances = initial_instances(context.limits(), gaussians, width, height);
        FrameCapacity { gaussians, instances, width, height, blend_passes: 1, backward: true }
    }

    /// How many Gaussians to make room for at the start: half as many again as there are, or as many as the memory holds.
    ///
    /// # Errors
    /// [`Error::TooLarge`] with what is needed, when even those that are there do not fit.
    pub fn initial_capacity(&self, context: &Context) -> Result<u32> {
        let Self { cameras, ref photo_bytes, count, sh_degree } = *self;
        let most = max_trained_gaussians(context.limits());
        if count > most {
            return Err(Error::TooLarge {
                what: "the gradients of the scene".into(),
                needed: count.into(),
                unit: "Gaussians",
                limit: most.into(),
                limit_name: "what maxStorageBufferRange holds",
            });
        }
        // Room to grow: densification allocates anew when it does not suffice.
        let wanted = count.saturating_add(count / 2).max(1 << 12).min(most);
        let Some((limit, limit_name)) = context.memory_limit() else { return Ok(wanted) };
        let free = limit.saturating_sub(context.memory_total().bytes);
        let buffers = |capacity: u32| -> Result<u64> {
            let plan = ScenePlan::new(context.limits(), capacity, sh_degree)?;
            Ok(self.buffer_bytes(context, &plan, Some(self.first_frame(context, capacity))))
        };
        let photos = photo_bytes.held + photo_bytes.staging;
        if buffers(wanted)? + photos <= free {
            return Ok(wanted);
        }
        let least = buffers(count)?;
        if least + photos <= free {
            return Ok(count);
        }
        // Photographs that may take half of the memory take more where there is more: all, or half of what is asked for.
        let follow = photo_bytes.budget == Some(limit / 2);
        let with_more = if follow { photo_bytes.all.min(least) + photo_bytes.staging } else { photos };
        let what = format!(
            "training {count} Gaussians of SH degree {sh_degree} on {} photographs (fewer or smaller ones need less, or --photo-memory)",
            cameras.len()
        );
        Err(Error::TooLarge {
            what,
            needed: least + with_more.max(photos),
            unit: "bytes",
            limit: free,
            limit_name,
        })
    }

    /// Whether what a run before had is possible here, and worth having: it holds the Gaussians, and fits.
    pub fn has_room(&self, context: &Context, room: &Room) -> bool {
        let limits = context.limits();
        let Ok(plan) = ScenePlan::new(limits, room.gaussians, self.sh_degree) else { return false };
        let sizes = LaunchSizes::new(limits);
        let frame = room.frame();
        let fits = frame.is_none_or(|frame| {
            let one = |(_, bytes): &(_, u64)| {
                *bytes <= limits.max_storage_buffer_range.min(limits.max_allocation_bytes)
            };
            check_grids(limits, &frame, &sizes).is_ok() && frame_requests(&frame, &sizes).iter().all(one)
        });
        if !fits || !(self.count..=max_trained_gaussians(limits)).contains(&room.gaussians) {
            return false;
        }
        let needed = self.buffer_bytes(context, &plan, frame) + self.photo_bytes.held;
        context
            .memory_limit()
            .is_none_or(|(limit, _)| needed <= limit.saturating_sub(context.memory_total().bytes))
    }
}

/// How many Gaussians to make room for when `rows` do not fit: half as many again, or as many as can be trained.
pub(super) fn grown_capacity(context: &Context, rows: u32) -> u32 {
    let most = max_trained_gaussians(context.limits());
    rows.saturating_add(rows / 2).min(most.max(rows))
}

/// What a training run has at present.
pub(super) struct Present<'a> {
    pub context: &'a Context,
    pub plan: &'a ScenePlan,
    pub frame: FrameCapacity,
    /// Of the frame's buffers, as they are allocated.
    pub frame_bytes: u64,
}

impl Present<'_> {
    /// Whether planes for a plan and a frame of as many Gaussians fit beside the planes of now, and, once those are gone, a
    /// frame with as many more instances.
    pub fn has_room(&self, plan: &ScenePlan) -> bool {
        let Self { context, plan: old, frame, frame_bytes: old_frame } = self;
        let limits = context.limits();
        if plan.capacity > max_trained_gaussians(limits) {
            return false;
        }
        let Some((limit, _)) = context.memory_limit() else { return true };
        let sizes = LaunchSizes::new(limits);
        let grown = FrameCapacity { gaussians: plan.capacity, ..*frame };
        // More Gaussians have more instances.
        let instances =
            u64::from(frame.instances) * u64::from(plan.capacity) / u64::from(old.capacity.max(1));
        let full =
            FrameCapacity { instances: instances.min(max_trained_instances(limits).into()) as u32, ..grown };
        let beside = (context.memory_total().bytes + sets_bytes(plan)).saturating_sub(*old_frame);
        let during = beside + frame_bytes(&grown, &sizes);
        let after = (beside + frame_bytes(&full, &sizes)).saturating_sub(sets_bytes(old));
        during.max(after) <= limit
    }

    /// The most rows up to `rows` for which there is room; at least what there is room for already.
    pub fn most_with_room(&self, rows: u32) -> Result<u32> {
        let (mut fits, mut beyond) = (self.plan.capacity, rows);
        while beyond.saturating_sub(fits) > (self.plan.capacity / 64).max(1) {
            let middle = fits + (beyond - fits) / 2;
            let plan = ScenePlan::new(self.context.limits(), middle, self.plan.sh_degree)?;
            if self.has_room(&plan) { fits = middle } else { beyond = middle }
        }
        Ok(fits)
    }

    /// How many rows a densification of `before` Gaussians may leave so that frames like those before it, which had at most
    /// so many instances, keep within three quarters of what the device can hold: views differ. None is added where the
    /// memory does not hold those frames.
    pub fn most_rows_by_instances(&self, before: u32, instances: u32) -> u32 {
        if !self.holds(instances) {
            return before;
        }
        let most = u64::from(max_trained_instances(self.context.limits())) * 3 / 4;
        let rows = u64::from(before) * most / u64::from(instances.max(1));
        rows.clamp(before.into(), u32::MAX.into()) as u32
    }

    /// Whether the memory has room for a frame with so many instances.
    fn holds(&self, instances: u32) -> bool {
        let Some((limit, _)) = self.context.memory_limit() else { return true };
        let full = FrameCapacity { instances: instances.max(self.frame.instances), ..self.frame };
        let beside = self.context.memory_total().bytes.saturating_sub(self.frame_bytes);
        instances <= self.frame.instances
            || beside + frame_bytes(&full, &LaunchSizes::new(self.context.limits())) <= limit
    }
}

/// What is remembered of the most instances of a frame when a densification of `before` Gaussians has left `rows`: as many
/// per Gaussian, but for a twentieth. After a reset of the opacities frames have few for a while, and then as many again.
pub(super) fn remembered_instances(most: u32, before: u32, rows: u32) -> u32 {
    let per_gaussian = u64::from(most) * u64::from(rows) / u64::from(before.max(1));
    (per_gaussian * 19 / 20).min(u32::MAX.into()) as u32
}

#[cfg(test)]
mod tests {
    use super::remembered_instances;

    #[test]
    fn what_frames_needed_before_a_reset_is_remembered_for_a_while() {
        // Five densifications by a twentieth each, while opacities come back: three quarters are remembered.
        let (mut most, mut rows) = (1_000_000, 100_000);
        for _ in 0..5 {
            most = remembered_instances(most, rows, rows / 20 * 21);
            rows = rows / 20 * 21;
        }
        let per_gaussian = f64::from(most) / f64::from(rows);
        assert!((7.5..8.0).contains(&per_gaussian), "{per_gaussian}");
        assert_eq!(remembered_instances(u32::MAX, 1, 2), u32::MAX);
        assert_eq!(remembered_instances(7, 0, 0), 0);
    }
}
