// Tiles of a footprint, packed into two words if they are few.
// First word: LISTED | number of tiles | column of the first row's first tile | first tile of the bounding box.
// Second word: for every possible row except the last, the number of tiles up to its end; then, for every row after the first,
// the column of its first tile. Columns count from the left side of the box. If the tiles do not fit, the first word is their
// number and there is no list.
const uint LISTED = 0x80000000u;
const uint LISTED_TILES = 31;
const uint LISTED_COLUMNS = 8;
const uint LISTED_ROWS = 5;
const uint LIST_TILES_BITS = 5;
const uint LIST_COLUMN_BITS = 3;
const uint LIST_TILES_SHIFT = 31 - LIST_TILES_BITS;
const uint LIST_COLUMN_SHIFT = LIST_TILES_SHIFT - LIST_COLUMN_BITS;
const uint LIST_COLUMNS_SHIFT = 32 - LIST_COLUMN_BITS * (LISTED_ROWS - 1);

bool is_listed(uvec2 list) {
    return (list.x & LISTED) != 0;
}

uint tiles_met(uvec2 list) {
    return is_listed(list) ? list.x >> LIST_TILES_SHIFT & LISTED_TILES : list.x;
}

// Tile at `index` in the list.
uint listed_tile(uvec2 list, uint index, uint tiles_per_row) {
    uint row = 0;
    uint before = 0;
    for (uint k = 0; k < LISTED_ROWS - 1; ++k) {
        uint end = list.y >> LIST_TILES_BITS * k & LISTED_TILES;
        bool behind = index >= end;
        row += behind ? 1 : 0;
        before = behind ? end : before;
    }
    uint column = row == 0 ? list.x >> LIST_COLUMN_SHIFT : list.y >> LIST_COLUMNS_SHIFT + LIST_COLUMN_BITS * (row - 1);
    uint first_tile = list.x & (1u << LIST_COLUMN_SHIFT) - 1;
#ifdef LENSES
    // Beyond the seam of a panorama.
    uint last_column = first_tile % tiles_per_row + (column & LISTED_COLUMNS - 1) + index - before;
    first_tile -= last_column / tiles_per_row * tiles_per_row;
#endif
    return first_tile + row * tiles_per_row + (column & LISTED_COLUMNS - 1) + index - before;
}
