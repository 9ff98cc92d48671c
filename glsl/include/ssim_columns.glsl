// Reads columns of both pictures, in strips. All texels below the picture are 0. `rendered` has three planes of f32. `photo`
// has three planes of bytes (255 is 1) or of f32. With MASKED, `photo` is 0 at pixels that do not count, and has a fourth plane
// that is nonzero at pixels that count.
// Needs strips.glsl, FLOAT_PHOTO, MASKED (not with FLOAT_PHOTO), and the texels `rendered` and `photo`.

const uint MASK_PLANE = 3;

uvec2 photo_bytes(uint column) {
    uvec4 two_columns = floatBitsToUint(texelFetch(photo, int(column / 2)));
    return column % 2 == 0 ? two_columns.xy : two_columns.zw;
}

uint photo_byte(uvec2 bytes, uint row) {
    return bytes[row / 4] >> (8 * (row % 4)) & 0xFF;
}

// Rendered value x and photograph's value y at each row of a column; `mask_column` is the same column in the mask plane.
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
