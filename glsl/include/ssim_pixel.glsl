// Both pictures at one pixel.
// Needs FLOAT_PHOTO, MASKED (RGBA8 only), the buffers `accumulated` and `photo`, and the push constant `background`.

// True if a pixel counts. The mask multiplies both pictures, so a masked pixel is 0 in both.
bool counts(uint pixel) {
    return !MASKED || photo[pixel] >> 24 != 0;
}

// Rendered value x and photograph's value y at a pixel.
vec2 rendered_and_photo(uint pixel, uint channel) {
    vec4 rendered = accumulated[pixel];
    uint word = photo[FLOAT_PHOTO ? 3 * pixel + channel : pixel];
    float y = FLOAT_PHOTO ? uintBitsToFloat(word) : float(word >> (8 * channel) & 0xFF) / 255.0;
    vec2 value = vec2(rendered[channel] + rendered.w * background[channel], y);
    return MASKED && word >> 24 == 0 ? vec2(0.0) : value;
}
