//! Lists of tiles, read as `glsl/include/tile_list.glsl` describes them.

/// Set in the first word of a list.
pub const LISTED: u32 = 1 << 31;

/// True if the words are a list.
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
