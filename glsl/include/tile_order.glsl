// Which tile a workgroup has. Drivers of processors deal every thread one run of consecutive workgroups, and the middle of a
// picture has more to blend than its top and bottom. So its rows of tiles are dealt to `tile_row_interleave` strands, a power of two,
// and the strands taken in the order of their numbers' bits reversed: each half of the workgroups has every other row, each
// quarter every fourth. A single strand is row by row.
// Needs the push constants `tiles_per_row`, `tile_count` and `tile_row_interleave`.
uint tile_of(uint workgroup) {
    uint rows = tile_count / tiles_per_row;
    uint left = workgroup / tiles_per_row;
    uint row = left;
    bool found = tile_row_interleave <= 1 || workgroup >= tile_count;
    for (uint k = 0; k < tile_row_interleave; ++k) {
        uint strand = bitfieldReverse(k) >> (32 - max(findMSB(tile_row_interleave), 1));
        uint length = (rows + tile_row_interleave - 1 - strand) / tile_row_interleave;
        row = !found && left < length ? strand + left * tile_row_interleave : row;
        found = found || left < length;
        left -= length;
    }
    return row * tiles_per_row + workgroup % tiles_per_row;
}
