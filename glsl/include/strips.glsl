// Planes of one value per pixel in strips of STRIP_ROWS rows, as processors have what blending, loss and blending's backward
// hand on: the values of a strip's column lie side by side, column by column, strip by strip, plane by plane. Who has a
// column of pixels reads and writes it at once, and who goes along a strip goes on in memory (engine/plan/strips.rs).
// Needs image_width, image_height.

const uint STRIP_ROWS = 8;

uint strips_of_image() {
    return (image_height + STRIP_ROWS - 1) / STRIP_ROWS;
}

// Columns from one strip to the next. Never a multiple of four: a column of 32 bytes, of pictures, would begin at the same set of
// a cache in every strip, where a sweep reads three of them in eight lanes.
uint strip_pitch() {
    return (image_width + 1) / 4 * 4 + 2;
}

// Place of a column among those of all planes.
uint strip_column(uint plane, uint strip, uint x) {
    return (plane * strips_of_image() + strip) * strip_pitch() + x;
}

// Where four rows of a column lie in planes of floats, in vec4: `at.y` is a multiple of 4.
uint strip_texel(uint plane, uvec2 at) {
    return STRIP_ROWS / 4 * strip_column(plane, at.y / STRIP_ROWS, at.x) + at.y / 4 % (STRIP_ROWS / 4);
}
