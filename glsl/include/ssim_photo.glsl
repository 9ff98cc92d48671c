// The photograph's planes. Needs FLOAT_PHOTO and the texels `photo_planes`.

vec4 photo_texel(uint texel) {
    if (FLOAT_PHOTO) {
        vec4 values;
        [[unroll]] for (uint k = 0; k < 4; ++k) {
            values[k] = uintBitsToFloat(texelFetch(photo_planes, int(4 * texel + k)).x);
        }
        return values;
    }
    uint word = texelFetch(photo_planes, int(texel)).x;
    return vec4((uvec4(word) >> uvec4(0, 8, 16, 24)) & 0xFF) / 255.0;
}
