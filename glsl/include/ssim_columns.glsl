// Columns of both pictures, in strips.
// Needs strips.glsl, FLOAT_PHOTO, MASKED (not with FLOAT_PHOTO), and the texels `rendered`, three planes of f32, and `photo`: three
// planes of bytes, 255 being 1, or of f32; with MASKED it is 0 where the photograph does not count, and a fourth plane is not 0
// where it does. All are 0 below the picture.

const uint MASK_PLANE = 3;

uvec2 photo_bytes(uint column) {
    uvec4 two_columns = floatBitsToUint(texelFetch(photo, int(column / 2)));
    return column % 2 == 0 ? two_columns.xy : two_columns.zw;
}

uint photo_byte(uvec2 bytes, uint row) {
    return bytes[row / 4] >> (8 * (row % 4)) & 0xFF;
}

// Rendered value x and the photograph's y at each row of a column; `mask_column` is the same column of the mask.
void read_column(uint column, uint mask_column, out vec2 values[STRIP_ROWS]) {
    uvec2 bytes = uvec2(0), mask = uvec2(0);
    if (!FLOAT_PHOTO) bytes = photo_bytes(column);
    if (MASKED) mask = photo_bytes(mask_column);
    [[unroll]] for (uint part = 0; part < STRIP_ROWS / 4; ++part) {
        int texel = int(STRIP_ROWS / 4 * column + part);
        vec4 x = texelFetch(rendered, texel);
        vec4 y = vec4(0.0);
        if (FLOAT_PHOTO) y = texelFetch(photo, texel);
        [[unroll]] for (uint k = 0; k < 4; ++k) {
            uint row = 4 * part + k;
            if (!FLOAT_PHOTO) y[k] = float(photo_byte(bytes, row)) / 255.0;
            bool counts = !MASKED || photo_byte(mask, row) != 0;
            values[row] = vec2(counts ? x[k] : 0.0, y[k]);
        }
    }
}
