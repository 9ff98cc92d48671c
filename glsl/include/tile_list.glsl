// The tiles of a footprint, where it meets few: LISTED | their number | column of the first row's first tile | the box's
// first tile; then the tiles up to the ends of all rows but the last possible one, and the columns of the first tiles of
// the rows below the first. Columns count from the box's. A footprint of more tiles has their number and no list.
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

// Tile number `left` of a list.
uint listed_tile(uvec2 list, uint left, uint tiles_per_row) {
    uint row = 0;
    uint before = 0;
    for (uint k = 0; k < LISTED_ROWS - 1; ++k) {
        uint end = list.y >> LIST_TILES_BITS * k & LISTED_TILES;
        bool behind = left >= end;
        row += behind ? 1 : 0;
        before = behind ? end : before;
    }
    uint column = row == 0 ? list.x >> LIST_COLUMN_SHIFT : list.y >> LIST_COLUMNS_SHIFT + LIST_COLUMN_BITS * (row - 1);
    uint first_tile = list.x & (1u << LIST_COLUMN_SHIFT) - 1;
    return first_tile + row * tiles_per_row + (column & LISTED_COLUMNS - 1) + left - before;
}
