// Writes a blended picture into a host's storage image of A2B10G10R10_UNORM_PACK32, bound as r32ui (compose.glsl).
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

// From the lowest bits: red, green and blue with 10 bits each, alpha with 2.
vec4 colors_of(uint texel) {
    uvec4 steps = uvec4(texel, texel >> 10, texel >> 20, texel >> 30) & uvec4(1023, 1023, 1023, 3);
    return vec4(steps) / vec4(1023.0, 1023.0, 1023.0, 3.0);
}

uint texel_of(vec4 color) {
    uvec4 steps = uvec4(clamp(color, 0.0, 1.0) * vec4(1023.0, 1023.0, 1023.0, 3.0) + 0.5);
    return steps.x | steps.y << 10 | steps.z << 20 | steps.w << 30;
}

#define COMPOSE_FORMAT r32ui
#define COMPOSE_IMAGE uimage2D
#define COMPOSE_LOAD(texel) colors_of((texel).x)
#define COMPOSE_STORE(color) uvec4(texel_of(color))
#include "compose.glsl"
