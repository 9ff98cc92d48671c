//! Lists of visible Gaussians and of tiles: the twins of `forward/compact`, of the arguments that `scan/scan_spine` writes, of
//! `forward/count`, `forward/duplicate_with_tiles` and `forward/ranges`. Lists of tiles are those of
//! `glsl/include/tile_list.glsl`.

use super::tiles;
use super::types::{Splat, View};
use std::ops::Range;

/// Place of an index that is not in the list.
pub const NOT_LISTED: u32 = u32::MAX;

/// Returns the first `capacity` flagged indices, and the place of each index in that list or [`NOT_LISTED`].
pub fn compact(flags: &[bool], capacity: usize) -> (Vec<u32>, Vec<u32>) {
    let mut list = Vec::new();
    let mut places = Vec::new();
    for (index, &flag) in flags.iter().enumerate() {
        let listed = flag && list.len() < capacity;
        places.push(if listed { list.len() as u32 } else { NOT_LISTED });
        if listed {
            list.push(index as u32);
        }
    }
    (list, places)
}

/// Returns the number of elements within the capacity, and true if some did not fit. `u32::MAX` means that 32 bits
/// do not hold the number: then 0, as their places are unknown.
pub fn clamp(needed: u32, capacity: u32) -> (u32, bool) {
    if needed == u32::MAX { (0, true) } else { (needed.min(capacity), needed > capacity) }
}

/// x, y, z for one workgroup per block: two-dimensional above the limit of an axis, all zero without elements.
pub fn workgroups(elements: u32, block: u32, limit_per_axis: u32) -> [u32; 3] {
    let groups = elements.div_ceil(block);
    if groups == 0 {
        return [0; 3];
    }
    let x = groups.min(limit_per_axis);
    [x, groups.div_ceil(x), 1]
}

/// [first visible, one past the last) of each range of `blocks_per_range` blocks of a scene. `block_offsets` counts
/// the visible before each block of the frame. `own`: the scene's blocks.
pub fn visible_ranges(
    block_offsets: &[u32],
    visible: u32,
    own: Range<usize>,
    blocks_per_range: usize,
) -> Vec<[u32; 2]> {
    let before = |block: usize| block_offsets.get(block).copied().unwrap_or(visible);
    let firsts = own.clone().step_by(blocks_per_range);
    firsts.map(|first| [before(first), before((first + blocks_per_range).min(own.end))]).collect()
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Instance {
    pub tile: u32,
    /// Bits of the float32 depth: positive, hence ordered as unsigned integers.
    pub depth_bits: u32,
    pub gaussian: u32,
}

pub fn expand(splats: &[Option<Splat>], view: &View) -> Vec<Instance> {
    let mut instances = Vec::new();
    for (gaussian, splat) in splats.iter().enumerate() {
        let Some(splat) = splat else { continue };
        for tile in tiles::touched(splat, view) {
            let depth_bits = (view.order_of(splat) as f32).to_bits();
            instances.push(Instance { tile, depth_bits, gaussian: gaussian as u32 });
        }
    }
    instances
}

/// [begin, end) per tile; an empty tile gets [0, 0).
pub fn ranges(sorted_tiles: &[u32], tile_count: u32) -> Vec<[u32; 2]> {
    let mut ranges = vec![[0, 0]; tile_count as usize];
    for (place, &tile) in sorted_tiles.iter().enumerate() {
        let range = &mut ranges[tile as usize];
        if place == 0 || sorted_tiles[place - 1] != tile {
            range[0] = place as u32;
        }
        range[1] = place as u32 + 1;
    }
    ranges
}

/// Set in the first word of a list.
pub const LISTED: u32 = 1 << 31;

pub fn is_listed([head, _]: [u32; 2]) -> bool {
    head & LISTED != 0
}

/// The number of tiles, listed or not.
pub fn tiles_met([head, rows]: [u32; 2]) -> u32 {
    if is_listed([head, rows]) { head >> 26 & 31 } else { head }
}

/// The tiles of a list, row by row.
pub fn listed_tiles([head, rows]: [u32; 2], tiles_per_row: u32) -> Vec<u32> {
    let mut tiles = Vec::new();
    let count = tiles_met([head, rows]);
    let mut begin = 0;
    for row in 0..5 {
        // The fifth row has no stored end; the first row's column is in the first word.
        let end = if row < 4 { (rows >> (5 * row) & 31).min(count) } else { count };
        let column = if row == 0 { head >> 23 & 7 } else { rows >> (20 + 3 * (row - 1)) & 7 };
        let first = (head & 0x7F_FFFF) + row * tiles_per_row + column;
        tiles.extend((0..end - begin).map(|i| first + i));
        begin = end;
    }
    tiles
}
