// Maps a workgroup to its tile. Drivers of processors give each thread one run of consecutive workgroups, and the middle of a
// picture has more Gaussians to blend than its top and bottom. To balance the threads, rows of tiles are interleaved: row r
// belongs to set r mod `tile_row_interleave`, a power of two, and the sets follow in bit-reversed order. Each half of the
// workgroups then has every second row, each quarter every fourth. A value of 1 gives row-major order.
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
