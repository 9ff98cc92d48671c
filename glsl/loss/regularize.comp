// Opacity and scale regularisers (3DGS-MCMC, Kheradmand et al. 2024, section 4): weighted means of the opacities and of
// the scales of all Gaussians, visible or not. Adds their gradient to that of the parameters.
//
// invocation: every (number of invocations)-th Gaussian of a chunk; the number of workgroups is TERM_PARTIALS
// in: parameters (PerGaussian planes)
// in/out: parameter_gradients (PerGaussian geometry planes: of opacity logit and log-scale);
//     partials[workgroup] = sums of (opacity, scale) over all chunks so far
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

layout(set = 0, binding = 0, scalar) readonly buffer Parameters { vec4 parameters[]; };
layout(set = 0, binding = 1, scalar) buffer ParameterGradients { vec4 parameter_gradients[]; };
layout(set = 0, binding = 2, scalar) buffer Partials { vec2 partials[]; };

layout(push_constant, scalar) uniform Push {
    uint count;
    // Nonzero if earlier chunks have written partial sums.
    uint continues;
    // Weight of an opacity and of a scale: that of the mean divided by the number of values.
    float opacity_weight;
    float scale_weight;
};

#include "opacity.glsl"
#include "planes.glsl"
#include "workgroup_sum.glsl"

void main() {
    vec2 sum = vec2(0.0);
    uint stride = TERM_PARTIALS * WORKGROUP_SIZE;
    for (uint index = gl_WorkGroupID.x * WORKGROUP_SIZE + gl_LocalInvocationID.x; index < count; index += stride) {
        uint opacity_at = geometry_at(PLANE_MEAN_OPACITY, index);
        uint scale_at = geometry_at(PLANE_LOG_SCALE, index);
        float opacity = opacity_of(parameters[opacity_at].w);
        vec3 scale = exp(parameters[scale_at].xyz);
        parameter_gradients[opacity_at].w += opacity_weight * opacity * (1.0 - opacity);
        parameter_gradients[scale_at].xyz += scale_weight * scale;
        sum += vec2(opacity, scale.x + scale.y + scale.z);
    }
    bool adds = continues != 0 && gl_LocalInvocationID.x == 0;
    vec2 total = workgroup_sum(sum, adds ? partials[gl_WorkGroupID.x] : vec2(0.0));
    if (gl_LocalInvocationID.x == 0) {
        partials[gl_WorkGroupID.x] = total;
    }
}
