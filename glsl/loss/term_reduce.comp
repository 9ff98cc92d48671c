// Adds the partial sums of a loss term in a fixed order: two weighted means, such as those of regularize.comp.
//
// invocation: every WORKGROUP_SIZE-th partial sum; one workgroup in all
// in: partials[TERM_PARTIALS]; out: losses[row] = (weighted sum of the means, both means, 0)
// shared: one vec2 per subgroup; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require

#include "constants.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(constant_id = 1) const uint SUBGROUP_SIZE = 32;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) readonly buffer Partials { vec2 partials[]; };
layout(set = 0, binding = 1, scalar) writeonly buffer Losses { vec4 losses[]; };

layout(push_constant, scalar) uniform Push {
    uint row;
    // Number of values in each mean.
    vec2 values;
    vec2 weights;
};

#include "workgroup_sum.glsl"

void main() {
    vec2 sum = vec2(0.0);
    for (uint index = gl_LocalInvocationID.x; index < TERM_PARTIALS; index += WORKGROUP_SIZE) {
        sum += partials[index];
    }
    vec2 total = workgroup_sum(sum, vec2(0.0));
    if (gl_LocalInvocationID.x == 0) {
        vec2 mean = total / values;
        losses[row] = vec4(weights.x * mean.x + weights.y * mean.y, mean, 0.0);
    }
}
