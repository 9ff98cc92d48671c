// Which tiles of one tile row a Gaussian's footprint meets. Counting and expanding must agree to the bit,
// hence `precise` throughout.
// Needs constants.glsl and a push constant `extent`.

// The ellipse conic(e, e) <= level around the mean, cut by the row's pixel centres, spans [left, right] in x:
// x = -(B/A) y -+ w sqrt(1 - (y/h)^2), extreme at y = -+ B hx / C or at the row's edge.
// Returns (first tile, one past the last tile).
uvec2 tile_span(uint row, vec4 mean2d_extent_px, vec4 conic, uvec2 tiles_x) {
    if (extent == EXTENT_REFERENCE) {
        return tiles_x;
    }
    precise float low = float(row * TILE_SIZE) - mean2d_extent_px.y;
    precise float high = low + float(TILE_SIZE - 1);
    precise float half_x = mean2d_extent_px.z;
    precise float half_y = mean2d_extent_px.w;
    low = max(low, -half_y);
    high = min(high, half_y);
    precise float y_right = clamp(-conic.y * half_x / conic.z, low, high);
    precise float y_left = clamp(conic.y * half_x / conic.z, low, high);
    precise float shear = -conic.y / conic.x;
    precise float level = 2.0 * log(255.0 * conic.w);
    level = max(level, 0.0) * 1.0001 + 0.002;
    precise float half_width = sqrt(level / conic.x) * 1.0001 + 0.001;
    precise float rise_right = y_right / half_y;
    precise float rise_left = y_left / half_y;
    precise float right = shear * y_right + half_width * sqrt(max(0.0, 1.0 - rise_right * rise_right));
    precise float left = shear * y_left - half_width * sqrt(max(0.0, 1.0 - rise_left * rise_left));
    // Rounding of the terms above grows with their size; the margin grows with it.
    precise float margin = 0.02 + 1e-5 * (half_x + half_y);
    right = min(right + margin, half_x);
    left = max(left - margin, -half_x);
    precise float first = ceil((mean2d_extent_px.x + left - float(TILE_SIZE - 1)) / float(TILE_SIZE));
    precise float last = floor((mean2d_extent_px.x + right) / float(TILE_SIZE)) + 1.0;
    uint x0 = uint(clamp(first, float(tiles_x.x), float(tiles_x.y)));
    uint x1 = uint(clamp(last, float(x0), float(tiles_x.y)));
    return uvec2(x0, x1);
}
