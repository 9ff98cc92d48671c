// Writes a blended picture into a host's storage image of format rgba16f (compose.glsl).
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

#define COMPOSE_FORMAT rgba16f
#define COMPOSE_LARGEST 65504.0
#include "compose.glsl"
