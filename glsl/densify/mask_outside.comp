// Masks the statistics of Gaussians outside a block's core, so that density control adds no Gaussians there. The sum of
// gradient norms becomes OUTSIDE_STATISTIC, which lies below every threshold. The numbers of views stay.
//
// invocation: one Gaussian of a chunk
// in: parameters (PerGaussian planes); in/out: statistics[Gaussian] (sum of norms, views)
// shared: none; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require

#include "constants.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) readonly buffer Parameters { vec4 parameters[]; };
layout(set = 0, binding = 1, scalar) writeonly buffer Statistics { vec2 statistics[]; };

layout(push_constant, scalar) uniform Push {
    uint first;
    uint count;
    // Corners of the core, world units. Its sides are inside.
    vec3 core_low;
    vec3 core_high;
};

#include "dispatch.glsl"
#include "planes.glsl"

void main() {
    uint index = linear_invocation();
    if (index >= count) {
        return;
    }
    vec3 mean = parameters[geometry_at(PLANE_MEAN_OPACITY, index)].xyz;
    if (all(greaterThanEqual(mean, core_low)) && all(lessThanEqual(mean, core_high))) {
        return;
    }
    statistics[first + index].x = OUTSIDE_STATISTIC;
}
