// Tiles that a Gaussian's footprint touches: the rows of tiles of its bounding box, and in each row the tiles that the ellipse
// touches. The count (project) and the duplication (duplicate_with_tiles) must agree to the bit, hence `precise` throughout.
// Needs constants.glsl and a push constant `extent`.
//
// A footprint is four words. Exact extent: shape of the rows (row_shape), number of tiles. Reference extent: x0 | x1 << 16
// and y0 | y1 << 16 in tiles, the radius in px, number of tiles.

#include "tile_list.glsl"
#ifdef LENSES
#include "seam.glsl"
#endif

// Tiles with pixel centres of the box: (x0, x1, y0, y1), where x1 and y1 are one past the last. Tile t has the pixel centres 16
// t .. 16 t + 15.
uvec4 tile_box(vec4 mean2d_extent_px, uvec2 grid) {
    precise vec2 low = ceil((mean2d_extent_px.xy - mean2d_extent_px.zw - float(TILE_SIZE - 1)) / float(TILE_SIZE));
    precise vec2 high = floor((mean2d_extent_px.xy + mean2d_extent_px.zw) / float(TILE_SIZE)) + 1.0;
    uvec2 first = uvec2(clamp(low, vec2(0.0), vec2(grid)));
    uvec2 last = uvec2(clamp(high, vec2(0.0), vec2(grid)));
#ifdef LENSES
    if (SPHERICAL) {
        precise float left = mean2d_extent_px.x - mean2d_extent_px.z;
        precise float right = mean2d_extent_px.x + mean2d_extent_px.z;
        uvec2 columns = turned_columns(left, right, grid.x, image_width, whole_width);
        // Rows of a Gaussian that spans a whole turn may begin at any column, and end up to a turn later.
        uint end = columns.y == columns.x + grid.x ? 2 * grid.x : columns.y;
        return uvec4(columns.x, end, first.y, last.y);
    }
#endif
    return uvec4(first.x, last.x, first.y, last.y);
}

uvec2 pack_tiles(uvec4 box) {
    return uvec2(box.x | box.y << 16, box.z | box.w << 16);
}

uvec4 unpack_tiles(uvec2 packed) {
    return uvec4(packed.x & 0xFFFF, packed.x >> 16, packed.y & 0xFFFF, packed.y >> 16);
}

// Terms shared by all rows of an ellipse conic(e, e) <= level, as bits of floats. They are the height of its leftmost point,
// the slope of the midpoints of its rows, and its half width at the mean.
uvec3 row_shape(vec4 mean2d_extent_px, vec4 conic_opacity) {
    precise float leftmost = conic_opacity.y * mean2d_extent_px.z / conic_opacity.z;
    precise float slope = -conic_opacity.y / conic_opacity.x;
    precise float level = 2.0 * log(255.0 * conic_opacity.w);
    level = max(level, 0.0) * 1.0001 + 0.002;
    precise float half_width = sqrt(level / conic_opacity.x) * 1.0001 + 0.001;
    return floatBitsToUint(vec3(leftmost, slope, half_width));
}

// Tiles of one row: (first tile, one past the last). Within the row's pixel centres, the ellipse spans [left, right] in x: x =
// slope y -+ w sqrt(1 - (y/h)^2), with extremes at y = -+ leftmost or at the edges of the row.
uvec2 tile_span(uint row, vec4 mean2d_extent_px, uvec3 shape, uvec2 tiles_x) {
    if (extent == EXTENT_REFERENCE) {
        return tiles_x;
    }
    vec3 form = uintBitsToFloat(shape);
    precise float low = float(row * TILE_SIZE) - mean2d_extent_px.y;
    precise float high = low + float(TILE_SIZE - 1);
    float half_x = mean2d_extent_px.z;
    float half_y = mean2d_extent_px.w;
    low = max(low, -half_y);
    high = min(high, half_y);
    precise float y_right = clamp(-form.x, low, high);
    precise float y_left = clamp(form.x, low, high);
    precise float rise_right = y_right / half_y;
    precise float rise_left = y_left / half_y;
    precise float right = form.y * y_right + form.z * sqrt(max(0.0, 1.0 - rise_right * rise_right));
    precise float left = form.y * y_left - form.z * sqrt(max(0.0, 1.0 - rise_left * rise_left));
    // The margin grows with the terms above, like their rounding error.
    precise float margin = 0.02 + 1e-5 * (half_x + half_y);
    right = min(right + margin, half_x);
    left = max(left - margin, -half_x);
#ifdef LENSES
    if (SPHERICAL) {
        precise float row_low = mean2d_extent_px.x + left;
        precise float row_high = mean2d_extent_px.x + right;
        uint columns = (image_width + TILE_SIZE - 1) / TILE_SIZE;
        uvec2 span = turned_columns(row_low, row_high, columns, image_width, whole_width);
        span += span.x < tiles_x.x ? columns : 0;
        return clamp(span, uvec2(tiles_x.x), uvec2(tiles_x.y));
    }
#endif
    precise float first = ceil((mean2d_extent_px.x + left - float(TILE_SIZE - 1)) / float(TILE_SIZE));
    precise float last = floor((mean2d_extent_px.x + right) / float(TILE_SIZE)) + 1.0;
    uint x0 = uint(clamp(first, float(tiles_x.x), float(tiles_x.y)));
    uint x1 = uint(clamp(last, float(x0), float(tiles_x.y)));
    return uvec2(x0, x1);
}

// Packs the tiles of all rows of a box with at least one row. The second word is 0 if the tiles do not fit into a list.
uvec2 list_tiles(vec4 mean2d_extent_px, uvec3 shape, uvec4 box, uint tiles_per_row) {
    uint tiles = 0;
    uint row = 0;
    uint first_column = 0;
    uint columns = 0;
    // Row ends that are never set belong to rows after the last, which have no tiles.
    uint unset = 0;
    // Tested at its end: see blend.comp.
    for (;;) {
        uvec2 span = tile_span(box.z + row, mean2d_extent_px, shape, box.xy);
        // A row without tiles has no first column, so any value works.
        uint column = span.x - box.x & LISTED_COLUMNS - 1;
        tiles += span.y - span.x;
        first_column = row == 0 ? column : first_column;
        columns |= row > 0 && row < LISTED_ROWS ? column << LIST_COLUMNS_SHIFT + LIST_COLUMN_BITS * (row - 1) : 0;
        unset |= row < LISTED_ROWS - 1 ? (tiles ^ LISTED_TILES) << LIST_TILES_BITS * row : 0;
        row += 1;
        if (box.z + row >= box.w) {
            break;
        }
    }
    uint first_tile = box.z * tiles_per_row + box.x;
    bool listed = tiles <= LISTED_TILES && box.y - box.x <= LISTED_COLUMNS && row <= LISTED_ROWS
        && first_tile < 1u << LIST_COLUMN_SHIFT;
    uint ends = ~unset & (1u << LIST_COLUMNS_SHIFT) - 1;
    uint head = LISTED | tiles << LIST_TILES_SHIFT | first_column << LIST_COLUMN_SHIFT | first_tile;
    return listed ? uvec2(head, columns | ends) : uvec2(tiles, 0);
}
