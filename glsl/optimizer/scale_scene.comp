// Scales a scene about a point: mean <- center + factor (mean - center), log-scale <- log-scale + log factor. The 3D filter's
// size, which is the log-scale's fourth component, scales too.
//
// invocation: one Gaussian
// in/out: parameters (PerGaussian planes; only means and log-scales change)
// shared: none; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require

#include "constants.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) buffer Parameters { vec4 parameters[]; };

layout(push_constant, scalar) uniform Push {
    uint count;
    vec3 center;
    // factor - 1, which would lose most of its digits in a factor.
    float growth;
    float log_factor;
};

#include "dispatch.glsl"
#include "planes.glsl"

void main() {
    uint index = linear_invocation();
    if (index >= count) {
        return;
    }
    uint at = geometry_at(PLANE_MEAN_OPACITY, index);
    vec3 mean = parameters[at].xyz;
    parameters[at].xyz = mean + growth * (mean - center);
    at = geometry_at(PLANE_LOG_SCALE, index);
    vec4 log_scale = parameters[at];
    parameters[at] = vec4(log_scale.xyz + log_factor, log_scale.w * (1.0 + growth));
}
