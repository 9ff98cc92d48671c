// Planes of one value per pixel in strips of STRIP_ROWS rows. On processors blending, the loss and the backward pass
// exchange data in this layout. The values of a strip's column are contiguous; columns, strips and planes follow in this
// order. An invocation that owns a column of pixels reads or writes it with one access, and a sweep along a strip reads
// consecutive memory (engine/frame/strips.rs).
// Needs constants.glsl, image_width, image_height.

uint strips_of_image() {
    return (image_height + STRIP_ROWS - 1) / STRIP_ROWS;
}

// Number of columns from one strip to the next; never a multiple of four. A column has 32 bytes, so with such a pitch it would
// map to the same cache set in every strip. A sweep reads three strips in eight lanes.
uint strip_pitch() {
    return (image_width + 1) / 4 * 4 + 2;
}

// Index of a column among the columns of all planes.
uint strip_column(uint plane, uint strip, uint x) {
    return (plane * strips_of_image() + strip) * strip_pitch() + x;
}

// Index in vec4 of four rows of a column, in planes of floats. `at.y` is a multiple of 4.
uint strip_texel(uint plane, uvec2 at) {
    return STRIP_ROWS / 4 * strip_column(plane, at.y / STRIP_ROWS, at.x) + at.y / 4 % (STRIP_ROWS / 4);
}

// Index of the value of a pixel.
uint strip_value(uint plane, uvec2 at) {
    return STRIP_ROWS * strip_column(plane, at.y / STRIP_ROWS, at.x) + at.y % STRIP_ROWS;
}
