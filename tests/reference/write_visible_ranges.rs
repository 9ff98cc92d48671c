//! Visible Gaussians in each range of parameters, the twin of `forward/write_visible_ranges`.

use std::ops::Range;

/// [first visible, one past the last) of each range of `blocks_per_range` blocks of a scene. `block_offsets` counts
/// the visible before each block of the frame. `own`: the scene's blocks.
pub fn ranges(
    block_offsets: &[u32],
    visible: u32,
    own: Range<usize>,
    blocks_per_range: usize,
) -> Vec<[u32; 2]> {
    let before = |block: usize| block_offsets.get(block).copied().unwrap_or(visible);
    let firsts = own.clone().step_by(blocks_per_range);
    firsts.map(|first| [before(first), before((first + blocks_per_range).min(own.end))]).collect()
}
