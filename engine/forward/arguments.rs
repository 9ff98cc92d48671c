//! Places of a frame's indirect arguments.

use crate::plan::{FrameBuffers, GaussianRange, LaunchSizes};
use crate::vk::Buffer;

/// Indirect arguments of a dispatch over the visible Gaussians of one parameter range. Their index in `visible_ranges` is that
/// of the range's first culling block.
pub(crate) fn range_arguments(frame: &FrameBuffers, sizes: &LaunchSizes, range: GaussianRange) -> Buffer {
    frame.visible_ranges.range(32 * u64::from(range.first / sizes.elementwise_workgroup), 12)
}

/// Indirect arguments at this index (ARGUMENTS_*).
pub(super) fn arguments(frame: &FrameBuffers, index: u32) -> Buffer {
    frame.arguments.range(u64::from(index) * 16, 12)
}
