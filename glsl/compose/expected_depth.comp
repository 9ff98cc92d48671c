// Writes the expected depth of each pixel, sum(w z) / sum(w) with the blending weights w, into a host's storage image.
//
// invocation: one pixel
// in, PerPixel: accumulated (.w = T, so that sum(w) = 1 - T), depth_sums (sum of w z)
// out: target (r32f), world units; `empty` if less than `min_weight` of the pixel is covered
// shared: none; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require

#include "constants.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) readonly buffer Accumulated { vec4 accumulated[]; };
layout(set = 0, binding = 1, scalar) readonly buffer DepthSums { float depth_sums[]; };
layout(set = 0, binding = 16, r32f) writeonly uniform image2D target;

layout(push_constant, scalar) uniform Push {
    uint image_width;
    uint image_height;
    // Texel of the target that receives pixel (0, 0).
    uint offset_x;
    uint offset_y;
    // A pixel with a smaller sum of weights counts as empty, and receives this depth.
    float min_weight;
    float empty;
};

#include "dispatch.glsl"

void main() {
    uint index = linear_invocation();
    if (index >= image_width * image_height) {
        return;
    }
    ivec2 at = ivec2(uvec2(index % image_width, index / image_width) + uvec2(offset_x, offset_y));
    float weight = 1.0 - accumulated[index].w;
    float depth = weight >= min_weight && weight > 0.0 ? depth_sums[index] / weight : empty;
    imageStore(target, at, vec4(depth, 0.0, 0.0, 0.0));
}
