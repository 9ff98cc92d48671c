// Writes a blended picture into a host's storage image of B10G11R11_UFLOAT_PACK32, bound as r32ui (compose.glsl).
//
//   out = (C, 1 - T) + T * below, where `below` is a background of alpha 1, zero (premultiplied colour), or the image
//
// invocation: one pixel
// in, PerPixel: accumulated (r, g, b without background, T); out, and in with COMPOSE_OVER: target
// shared: none; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require

#include "constants.glsl"

// From the lowest bits: red and green as floats with 5 exponent and 6 mantissa bits, then blue with 5 and 5. No sign, no alpha.
const uvec3 MANTISSA_BITS = uvec3(6, 6, 5);
const uvec3 FIRST_BITS = uvec3(0, 11, 22);
// Largest finite values; larger ones become infinity.
const vec3 LARGEST = vec3(65024.0, 65024.0, 64512.0);

vec4 colors_of(uint texel) {
    uvec3 bits = uvec3(texel) >> FIRST_BITS & (uvec3(32) << MANTISSA_BITS) - 1;
    uvec3 exponent = bits >> MANTISSA_BITS;
    uvec3 mantissa = bits & (uvec3(1) << MANTISSA_BITS) - 1;
    // Exponents are biased by 15 here, and by 127 in 32 bits.
    vec3 normal = uintBitsToFloat(exponent + 112 << 23 | mantissa << 23 - MANTISSA_BITS);
    vec3 subnormal = ldexp(vec3(mantissa), -14 - ivec3(MANTISSA_BITS));
    return vec4(mix(normal, subnormal, equal(exponent, uvec3(0))), 1.0);
}

// Rounds to the nearest number, ties to even.
uint texel_of(vec4 color) {
    vec3 size = clamp(color.xyz, vec3(0.0), LARGEST);
    uvec3 dropped = 23 - MANTISSA_BITS;
    uvec3 bits = floatBitsToUint(size);
    uvec3 normal = (bits + (uvec3(1) << dropped - 1) - 1 + (bits >> dropped & 1) >> dropped) - (uvec3(112) << MANTISSA_BITS);
    uvec3 subnormal = uvec3(roundEven(ldexp(size, 14 + ivec3(MANTISSA_BITS))));
    uvec3 parts = mix(normal, subnormal, lessThan(size, vec3(6.103515625e-5)));
    return parts.x | parts.y << 11 | parts.z << 22;
}

#define COMPOSE_FORMAT r32ui
#define COMPOSE_IMAGE uimage2D
#define COMPOSE_LOAD(texel) colors_of((texel).x)
#define COMPOSE_STORE(color) uvec4(texel_of(color))
#include "compose.glsl"
