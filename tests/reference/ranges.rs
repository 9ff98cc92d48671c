//! Begin and end of each tile's run in the sorted instances, the twin of `forward/ranges`.

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
