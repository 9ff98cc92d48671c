// Points of known depth in a picture. A point is sampled bilinearly from four pixels with centres at the integers. The last row
// and column replace those beyond.
// Needs the push constants `image_width` and `image_height`.

// Index of the pixel at a corner of the point, 0 to 3: the first bit moves right, the second one down.
uint corner_pixel(vec2 point_px, uint corner) {
    uvec2 at = uvec2(point_px) + uvec2(corner & 1, corner >> 1);
    at = min(at, uvec2(image_width, image_height) - 1);
    return at.y * image_width + at.x;
}

float corner_weight(vec2 point_px, uint corner) {
    vec2 share = point_px - floor(point_px);
    return ((corner & 1) != 0 ? share.x : 1.0 - share.x) * ((corner >> 1) != 0 ? share.y : 1.0 - share.y);
}

// Expected depth of a pixel from the sum of weights z and its transmittance.
float covered(float transmittance) {
    return max(1.0 - transmittance, COVERAGE_MIN);
}
