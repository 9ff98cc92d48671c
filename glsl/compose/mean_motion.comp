// Writes the mean motion of each pixel, sum(w m) / sum(w) with the blending weights w, into a host's storage image.
//
// invocation: one pixel
// in, PerPixel: accumulated (.w = T, so that sum(w) = 1 - T), motion_sums (sum of w m, px)
// out: target (R16G16_SFLOAT, bound as r32ui), px; if less than `min_weight` of the pixel is covered, `empty`, or with `keeps`
//     unchanged
// shared: none; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require

#include "constants.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) readonly buffer Accumulated { vec4 accumulated[]; };
layout(set = 0, binding = 1, scalar) readonly buffer MotionSums { vec2 motion_sums[]; };
layout(set = 0, binding = 16, r32ui) writeonly uniform uimage2D target;

layout(push_constant, scalar) uniform Push {
    uint image_width;
    uint image_height;
    // Texel of the target that receives pixel (0, 0).
    uint offset_x;
    uint offset_y;
    // A pixel with a smaller sum of weights counts as empty. It receives `empty`, or nothing if `keeps` is 1.
    float min_weight;
    vec2 empty;
    uint keeps;
};

#include "dispatch.glsl"

void main() {
    uint index = linear_invocation();
    if (index >= image_width * image_height) {
        return;
    }
    ivec2 at = ivec2(uvec2(index % image_width, index / image_width) + uvec2(offset_x, offset_y));
    float weight = 1.0 - accumulated[index].w;
    bool covered = weight >= min_weight && weight > 0.0;
    vec2 motion = covered ? motion_sums[index] / weight : empty;
    if (covered || keeps == 0) {
        uint texel = packHalf2x16(clamp(motion, vec2(-MOTION_MAX), vec2(MOTION_MAX)));
        imageStore(target, at, uvec4(texel, 0, 0, 0));
    }
}
