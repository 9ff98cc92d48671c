// Inverse depth of a picture's surface, for the terms of the loss that shape it: d = sum(w / z) / sum(w), where sum(w) = 1 - T.
//
// invocation: one pixel
// in, PerPixel: accumulated (.w = T), depth_sums (of w / z); out: surface_depths, d or 0 where less than half is covered
// shared: none; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require

#include "constants.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) readonly buffer Accumulated { vec4 accumulated[]; };
layout(set = 0, binding = 1, scalar) readonly buffer DepthSums { float depth_sums[]; };
layout(set = 0, binding = 2, scalar) writeonly buffer SurfaceDepths { float surface_depths[]; };

layout(push_constant, scalar) uniform Push {
    uint pixels;
};

#include "dispatch.glsl"
#include "surface_loss.glsl"

void main() {
    uint index = linear_invocation();
    if (index < pixels) {
        float coverage = 1.0 - accumulated[index].w;
        surface_depths[index] = coverage > SURFACE_COVERAGE ? depth_sums[index] / coverage : 0.0;
    }
}
