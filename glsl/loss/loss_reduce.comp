// Adds the workgroups' sums in a fixed order to the loss of the iteration.
//
// invocation: every WORKGROUP_SIZE-th partial sum; one workgroup in all
// in: loss_partials[partials]; out: losses[loss_row] = (weight * L, mean |x - y|, mean SSIM, unused)
// shared: one vec2 per subgroup; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(constant_id = 1) const uint SUBGROUP_SIZE = 32;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) readonly buffer LossPartials { vec2 loss_partials[]; };
layout(set = 0, binding = 1, scalar) writeonly buffer Losses { vec4 losses[]; };

layout(push_constant, scalar) uniform Push {
    uint partials;
    uint loss_row;
    // 1 / (3 W H).
    float scale;
    float lambda_dssim;
    // Weight of the loss, but not of the means.
    float weight;
};

#include "ssim.glsl"
#include "workgroup_sum.glsl"

void main() {
    vec2 sum = vec2(0.0);
    for (uint index = gl_LocalInvocationID.x; index < partials; index += WORKGROUP_SIZE) {
        sum += loss_partials[index];
    }
    vec2 total = workgroup_sum(sum, vec2(0.0));
    if (gl_LocalInvocationID.x == 0) {
        total *= scale;
        losses[loss_row] = vec4(weight * total_loss(total, lambda_dssim), total, 0.0);
    }
}
