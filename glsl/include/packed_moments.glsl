// Adam's moments in few bits. A Gaussian has planes of uvec4 at half_plane_at: those of the geometry, then those of SH, two in one.
// All are zero for zero moments. Rounding up or down has no bias: each value has a threshold that starts at random and moves by the
// golden ratio from step to step. The errors of a few steps then cancel; with independent thresholds they would add up.
//
// Geometry: m as bfloat16 in .xy, v in .zw. Log-scales have three components. The fourth holds an upper bound of SH's v, as float32.
// SH: m / sqrt(v) = +-i^2 / 2048 with an int8 i, and log2(v) in steps of 1/8 (uint8). 0 means v = 0, and 255 is the power of
// two above the bound, so that steps keep their values while the bound changes. Steps cover the 31 octaves below it.

const float MOMENT_STEPS = 8.0;

// Logarithm of the highest step, in steps.
float highest_step(float bound) {
    return MOMENT_STEPS * (float(floatBitsToUint(bound) >> 23) - 126.0);
}

// Four rounding thresholds, in 1/65536, from the halves of two random words, advanced by `turn`.
uvec4 thresholds_of(uvec2 random, uint turn) {
    return uvec4(random.x, random.x >> 16, random.y, random.y >> 16) + turn & 0xFFFFu;
}

uint turn_of(uint iteration) {
    return iteration * 40503u;
}

vec4 from_bfloat16(uvec2 words) {
    return uintBitsToFloat(uvec4(words.x << 16, words.x & 0xFFFF0000u, words.y << 16, words.y & 0xFFFF0000u));
}

uvec2 to_bfloat16(vec4 values, uvec4 thresholds) {
    uvec4 bits = floatBitsToUint(values) + thresholds;
    return bits.xz >> 16 | bits.yw & 0xFFFF0000u;
}

// Halves of values. Below 2^-14 only 0 and 2^-14 are used, because devices may take smaller halves for 0.
uvec2 to_halves(vec4 values, uvec4 thresholds) {
    const float least = 6.103515625e-5;
    values = clamp(values, -65504.0, 65504.0);
    vec4 normal = uintBitsToFloat(floatBitsToUint(values) + (thresholds >> 3) & 0xFFFFE000u);
    vec4 small = mix(vec4(0.0), sign(values) * least, lessThan(vec4(thresholds) * (least / 65536.0), abs(values)));
    values = mix(normal, small, lessThan(abs(values), vec4(least)));
    return uvec2(packHalf2x16(values.xy), packHalf2x16(values.zw));
}

// Bound of SH's second moments, in the words of the log-scales' moments.
float bound_of(uvec4 words) {
    return uintBitsToFloat(words.y & 0xFFFF0000u | words.w >> 16);
}

uvec4 with_bound(uvec4 words, float bound) {
    uint bits = floatBitsToUint(bound);
    words.yw = words.yw & 0xFFFFu | uvec2(bits & 0xFFFF0000u, bits << 16);
    return words;
}

uvec4 bytes_of(uint word) {
    return uvec4(word, word >> 8, word >> 16, word >> 24) & 0xFFu;
}

uint word_of(uvec4 bytes) {
    return bytes.x | bytes.y << 8 | bytes.z << 16 | bytes.w << 24;
}

// sqrt(v) of the second moments' steps.
vec4 root_of_steps(vec4 steps, float highest) {
    return mix(exp2((steps + (highest - 255.0)) * (0.5 / MOMENT_STEPS)), vec4(0.0), equal(steps, vec4(0.0)));
}

// First moments and roots of the second ones.
void unpack_sh(uvec2 words, float highest, out vec4 m, out vec4 root) {
    root = root_of_steps(vec4(bytes_of(words.y)), highest);
    vec4 ratio = vec4(ivec4(bytes_of(words.x) << 24) >> 24);
    m = ratio * abs(ratio) * (root / 2048.0);
}

uvec2 pack_sh(vec4 m, vec4 v, float highest, uvec4 random, uint turn) {
    vec4 step = log2(v) * MOMENT_STEPS;
    vec4 above = fract(step);
    // Between two steps v is nearly linear: (2^(above / 8) - 1) / (2^(1 / 8) - 1).
    above *= 1.0 - 0.0415 * (1.0 - above);
    vec4 threshold = vec4(thresholds_of(random.xy, turn)) / 65536.0;
    vec4 steps = clamp(floor(step) + vec4(lessThan(threshold, above)) - (highest - 255.0), 1.0, 255.0);
    steps = mix(steps, vec4(0.0), equal(v, vec4(0.0)));
    vec4 square = abs(m) / root_of_steps(steps, highest) * 2048.0;
    vec4 ratio = floor(sqrt(square));
    above = (square - ratio * ratio) / (2.0 * ratio + 1.0);
    threshold = vec4(thresholds_of(random.zw, turn)) / 65536.0;
    ratio = min(ratio + vec4(lessThan(threshold, above)), 127.0);
    ratio = mix(sign(m) * ratio, vec4(0.0), equal(steps, vec4(0.0)));
    return uvec2(word_of(uvec4(ivec4(ratio)) & 0xFFu), word_of(uvec4(steps)));
}
