//! Where a frame's indirect arguments are.

use crate::plan::{FrameBuffers, GaussianRange, LaunchSizes};
use crate::vk::Buffer;

/// The indirect arguments of a dispatch over the visible Gaussians of one parameter range. Their index in
/// `visible_ranges` is that of the range's first culling block.
pub(crate) fn range_arguments(frame: &FrameBuffers, sizes: &LaunchSizes, range: GaussianRange) -> Buffer {
    frame.visible_ranges.range(32 * u64::from(range.first / sizes.elementwise_workgroup), 12)
}

/// The indirect arguments of this name (ARGUMENTS_*).
pub(super) fn arguments(frame: &FrameBuffers, index: u32) -> Buffer {
    frame.arguments.range(u64::from(index) * 16, 12)
}
