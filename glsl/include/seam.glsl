// The seam of a panorama: its columns continue on the other side. A Gaussian is drawn by its nearest turn.
// Needs constants.glsl, PROJECTION, and `image_width`, `whole_width`.

#define SPHERICAL (PROJECTION == PROJECTION_EQUIRECTANGULAR)

// Columns of tiles with pixel centres between two positions: first, and one past the last. Columns from `columns` on are those
// from 0 on.
uvec2 turned_columns(float low, float high, uint columns) {
    float period = float(whole_width);
    precise float turn = floor(low / period) * period;
    precise float begin = low - turn;
    precise float end = high - turn;
    precise float first = ceil((begin - float(TILE_SIZE - 1)) / float(TILE_SIZE));
    precise float last = floor(end / float(TILE_SIZE)) + 1.0;
    precise float behind = floor((end - period) / float(TILE_SIZE)) + 1.0;
    // A part of a panorama may begin behind the position.
    bool starts = begin <= float(image_width - 1);
    bool passes = end >= period;
    uint x0 = starts ? uint(clamp(first, 0.0, float(columns))) : columns;
    uint x1 = passes ? columns + uint(clamp(behind, 0.0, float(columns))) : uint(clamp(last, float(x0), float(columns)));
    uint back = x0 == columns ? columns : 0;
    bool all = !(high - low < period) || x1 - x0 > columns;
    return all ? uvec2(0, columns) : uvec2(x0, x1) - back;
}

// Position of the turn nearest to a tile.
float nearest_turn(float x, uint tile_column) {
    float period = float(whole_width);
    float middle = float(tile_column * TILE_SIZE) + 0.5 * float(TILE_SIZE - 1);
    return x + period * round((middle - x) / period);
}
