//! Grids of workgroups of a frame's dispatches.

use super::{FrameCapacity, LaunchSizes, blocks, tile_grid};
use crate::error::{Error, Result};
use crate::vk::Limits;

/// Checks that every dispatch of a frame of this capacity fits a grid of workgroups. Vulkan does not check
/// indirect dispatches.
///
/// # Errors
/// [`Error::TooLarge`] with the number of workgroups.
pub fn check_grids(limits: &Limits, capacity: &FrameCapacity, block: &LaunchSizes) -> Result<()> {
    let smallest = block.smallest();
    let (columns, rows) = tile_grid(capacity.width, capacity.height);
    let axis = u64::from(limits.max_workgroups_per_axis);
    let elements = u64::from(capacity.gaussians.max(capacity.instances));
    let checks = [
        (blocks(elements, smallest.into()), axis * axis),
        (u64::from(columns) * u64::from(rows), axis * axis),
        // The loss has one workgroup per tile.
        (u64::from(columns.max(rows).max(3)) * u64::from(capacity.backward), axis),
    ];
    match checks.iter().find(|(needed, limit)| needed > limit) {
        None => Ok(()),
        Some(&(needed, limit)) => Err(Error::TooLarge {
            what: format!(
                "a frame of {}x{} pixels, {} Gaussians and {} instances",
                capacity.width, capacity.height, capacity.gaussians, capacity.instances
            ),
            needed,
            unit: "workgroups",
            limit,
            limit_name: "maxComputeWorkGroupCount",
        }),
    }
}
