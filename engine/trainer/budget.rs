//! What a training run needs of memory, before it is asked for.

use crate::error::{Error, Result};
use crate::loss;
use crate::plan::{Blocks, FrameCapacity, ScenePlan, frame_bytes, initial_instances, max_trained_gaussians};
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

/// Bytes of everything else that a run begins with: the loss, a frame.
fn other_bytes(context: &Context, cameras: &[Camera], gaussians: u32) -> u64 {
    let largest = |f: &dyn Fn(&Camera) -> u64| cameras.iter().map(f).max().unwrap_or(0);
    let (width, height) = (largest(&|c| c.width.into()) as u32, largest(&|c| c.height.into()) as u32);
    let capacity = FrameCapacity {
        gaussians,
        instances: initial_instances(context.limits(), gaussians, width, height),
        width,
        height,
        blend_passes: 1,
        backward: true,
    };
    largest(&|c| loss::scratch_bytes(context.limits(), c.width, c.height))
        + frame_bytes(&capacity, &Blocks::new(context.limits()))
}

/// How many Gaussians to make room for at the start: half as many again as there are, or as many as the memory holds.
///
/// # Errors
/// [`Error::TooLarge`] with what is needed, when even `count` do not fit.
pub(super) fn initial_capacity(
    context: &Context,
    cameras: &[Camera],
    photo_bytes: u64,
    count: u32,
    sh_degree: u32,
) -> Result<u32> {
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
    let needed = |capacity: u32| -> Result<u64> {
        let plan = ScenePlan::new(context.limits(), capacity, sh_degree)?;
        Ok(sets_bytes(&plan) + photo_bytes + other_bytes(context, cameras, capacity))
    };
    if needed(wanted)? <= free {
        return Ok(wanted);
    }
    let least = needed(count)?;
    if least <= free {
        return Ok(count);
    }
    let what = format!(
        "training {count} Gaussians of SH degree {sh_degree} on {} photographs (fewer or smaller ones need less, or --photo-memory)",
        cameras.len()
    );
    Err(Error::TooLarge { what, needed: least, unit: "bytes", limit: free, limit_name })
}

/// How many Gaussians to make room for when `rows` do not fit: half as many again, or as many as can be trained.
pub(super) fn grown_capacity(context: &Context, rows: u32) -> u32 {
    let most = max_trained_gaussians(context.limits());
    rows.saturating_add(rows / 2).min(most.max(rows))
}

/// Whether planes for a plan fit beside what is allocated now, and then a frame of as many Gaussians once the old planes
/// are gone.
pub(super) fn has_room(context: &Context, plan: &ScenePlan, old: &ScenePlan, frame: &FrameCapacity) -> bool {
    if plan.capacity > max_trained_gaussians(context.limits()) {
        return false;
    }
    let Some((limit, _)) = context.memory_limit() else { return true };
    let sizes = Blocks::new(context.limits());
    let grown = FrameCapacity {
        gaussians: plan.capacity,
        // More Gaussians have more instances.
        instances: (u64::from(frame.instances) * u64::from(plan.capacity) / u64::from(old.capacity.max(1)))
            .min(u32::MAX.into()) as u32,
        ..*frame
    };
    let used = context.memory_total().bytes;
    let during = used + sets_bytes(plan);
    let after = (during + frame_bytes(&grown, &sizes))
        .saturating_sub(sets_bytes(old))
        .saturating_sub(frame_bytes(frame, &sizes));
    during.max(after) <= limit
}
