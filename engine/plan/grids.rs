//! Checks of the workgroup grids of a frame's dispatches.

use super::{FrameCapacity, LaunchSizes, PictureCapacity, blocks, frame_requests};
use crate::error::{Error, Result};
use crate::vk::Limits;

/// Checks that every dispatch of a frame of this capacity fits a grid of workgroups. Vulkan does not check
/// indirect dispatches.
///
/// # Errors
/// [`Error::TooLarge`] with the number of workgroups.
pub fn check_grids(limits: &Limits, capacity: &FrameCapacity, block: &LaunchSizes) -> Result<()> {
    let smallest = block.smallest();
    let PictureCapacity { pixels, tiles, side_tiles, .. } = capacity.pictures;
    let axis = u64::from(limits.max_workgroups_per_axis);
    let elements = u64::from(capacity.gaussians.max(capacity.instances));
    let checks = [
        (blocks(elements, smallest.into()), axis * axis),
        (tiles, axis * axis),
        // The loss has one workgroup per tile.
        (u64::from(side_tiles.max(3)) * u64::from(capacity.backward), axis),
    ];
    match checks.iter().find(|(needed, limit)| needed > limit) {
        None => Ok(()),
        Some(&(needed, limit)) => Err(Error::TooLarge {
            what: format!(
                "a frame of {pixels} pixels, {} Gaussians and {} instances",
                capacity.gaussians, capacity.instances
            ),
            needed,
            unit: "workgroups",
            limit,
            limit_name: "maxComputeWorkGroupCount",
        }),
    }
}

/// True if a device's limits allow the buffers and grids of a frame, regardless of memory.
pub fn frame_fits_device(limits: &Limits, capacity: &FrameCapacity, block: &LaunchSizes) -> bool {
    let most = limits.max_storage_buffer_range.min(limits.max_allocation_bytes);
    check_grids(limits, capacity, block).is_ok()
        && frame_requests(capacity, block).iter().all(|(_, bytes)| *bytes <= most)
}
