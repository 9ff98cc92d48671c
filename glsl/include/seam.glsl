// The seam of a panorama: its columns continue on the other side. At each pixel a Gaussian is drawn by its nearest turn.
// Needs constants.glsl, PROJECTION.

#define SPHERICAL (PROJECTION == PROJECTION_EQUIRECTANGULAR)

// Width of the whole panorama, px: kernels that blend set it.
float seam_period;

float to_nearest_turn(float dx) {
    return dx - seam_period * round(dx / seam_period);
}

// Columns of tiles with pixel centres between two positions of a panorama of `whole` columns, of which the picture has the first
// `width` in `columns` tiles: first column, and one past the last. Columns from `columns` on are those from 0 on.
uvec2 turned_columns(float low, float high, uint columns, uint width, uint whole) {
    float period = float(whole);
    precise float turn = floor(low / period) * period;
    precise float begin = low - turn;
    precise float end = high - turn;
    precise float first = ceil((begin - float(TILE_SIZE - 1)) / float(TILE_SIZE));
    precise float last = floor(end / float(TILE_SIZE)) + 1.0;
    precise float behind = floor((end - period) / float(TILE_SIZE)) + 1.0;
    // Between the picture and its next turn there may be columns that it does not show.
    uint x0 = begin <= float(width - 1) ? uint(clamp(first, 0.0, float(columns))) : columns;
    uint x1 = end >= period ? columns + uint(clamp(behind, 0.0, float(columns))) : uint(clamp(last, float(x0), float(columns)));
    bool all = !(high - low < period) || x1 - x0 > columns;
    uvec2 span = uvec2(x0, x1) - (x0 == columns ? columns : 0);
    return all ? uvec2(0, columns) : span;
}
