// Adam over all parameters of all Gaussians in one pass (Kingma and Ba 2015; torch.optim.Adam's form):
//
//   m <- b1 m + (1 - b1) g,  v <- b2 v + (1 - b2) g^2,  p <- p - rate / (1 - b1^t) m / (sqrt(v / (1 - b2^t)) + eps)
//
// Dense: Gaussians outside the view have a zero gradient, and their moments still decay. SPARSE: they are left alone.
// SH gradients are derived from the colour's here; planes above the active degree have neither gradient nor moments.
// A Gaussian with a gradient that is not finite is left as it was and counted. Nothing changes if the frame overflowed.
//
// invocation: one Gaussian
// in: visible_index, gradients (PerVisible planes), state
// in/out: parameters, moments_1, moments_2 (PerGaussian planes); state[STATE_NON_FINITE] counts the skipped
// shared: none; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_control_flow_attributes : require
#extension GL_GOOGLE_include_directive : require

#include "constants.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(constant_id = 2) const uint SH_DEGREE = 3;
layout(constant_id = 3) const bool SPARSE = false;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) buffer Parameters { vec4 parameters[]; };
layout(set = 0, binding = 1, scalar) buffer Moments1 { vec4 moments_1[]; };
layout(set = 0, binding = 2, scalar) buffer Moments2 { vec4 moments_2[]; };
layout(set = 0, binding = 3, scalar) readonly buffer VisibleIndex { uint visible_index[]; };
layout(set = 0, binding = 4, scalar) readonly buffer Gradients { vec4 gradients[]; };
layout(set = 0, binding = 5, scalar) buffer State { uint state[]; };

vec4 parameter_at(uint at) {
    return parameters[at];
}

vec4 moment_1_at(uint at) {
    return moments_1[at];
}

vec4 moment_2_at(uint at) {
    return moments_2[at];
}

vec4 gradient_at(uint at) {
    return gradients[at];
}

uint visible_index_at(uint at) {
    return visible_index[at];
}

#include "adam.glsl"
