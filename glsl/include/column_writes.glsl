// Writes a column of a strip with one wide store: on processors a store of any width is a loop over the lanes.
// Needs strips.glsl, GL_EXT_shader_explicit_arithmetic_types_int64.

uint64_t pair(float first, float second) {
    return packUint2x32(floatBitsToUint(vec2(first, second)));
}

u64vec4 eight(float values[STRIP_ROWS]) {
    return u64vec4(pair(values[0], values[1]), pair(values[2], values[3]), pair(values[4], values[5]),
        pair(values[6], values[7]));
}
