// Distance of the features of two pictures at each pixel (LPIPS, Zhang et al. 2018, equation 1): sum over channels c of head(c)
// * (a(c) / |a| - b(c) / |b|)^2, with |f| = sqrt(sum over c of f(c)^2) + 1e-10.
//
// invocation: one pixel
// in: features, a map (feature_map.glsl) of two pictures; heads of four channels each
// out: differences[(row - first) * width + x], of the rows first to first + rows
// shared: none; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require

#include "buffers.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(local_size_x_id = 0) in;

VEC4_READS(0, Features, features);
VEC4_READS(1, Heads, heads);
layout(set = 0, binding = 2, scalar) writeonly buffer Differences { float differences[]; };

layout(push_constant, scalar) uniform Push {
    uint blocks;
    uint width;
    uint slots;
    uint pitch;
    uint margin;
    uint first;
    uint rows;
};

#include "dispatch.glsl"
#include "feature_map.glsl"

const float NORM_OFFSET = 1e-10;

void main() {
    uint index = linear_invocation();
    if (index >= width * rows) {
        return;
    }
    uint y = first + index / width;
    uint plane = map_plane(slots, pitch);
    uint a = y % slots * pitch + margin + index % width;
    uint b = a + blocks * plane;
    vec2 squares = vec2(0.0);
    for (uint i = 0; i < blocks; ++i) {
        vec4 f = VEC4_AT(features, a + i * plane);
        vec4 g = VEC4_AT(features, b + i * plane);
        squares += vec2(dot(f, f), dot(g, g));
    }
    vec2 scale = 1.0 / (sqrt(squares) + NORM_OFFSET);
    float sum = 0.0;
    for (uint i = 0; i < blocks; ++i) {
        // `precise`: if only one of the products were rounded, equal features would differ.
        precise vec4 d = scale.x * VEC4_AT(features, a + i * plane) - scale.y * VEC4_AT(features, b + i * plane);
        sum += dot(VEC4_AT(heads, i), d * d);
    }
    differences[index] = sum;
}
