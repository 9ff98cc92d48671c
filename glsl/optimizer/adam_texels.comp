// The same as adam.comp, reading texels: for processors, to which that is a quarter of the work.
//
// invocation: one Gaussian
// in: visible_index, gradients (PerVisible planes), state; parameters and moments once more, as texels
// out: parameters, moments_1, moments_2 (PerGaussian planes); in/out: state[STATE_NON_FINITE] counts the skipped
// shared: none; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_control_flow_attributes : require
#extension GL_EXT_samplerless_texture_functions : require
#extension GL_GOOGLE_include_directive : require

#include "constants.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(constant_id = 2) const uint SH_DEGREE = 3;
layout(constant_id = 3) const bool SPARSE = false;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) writeonly buffer Parameters { vec4 parameters[]; };
layout(set = 0, binding = 1, scalar) writeonly buffer Moments1 { vec4 moments_1[]; };
layout(set = 0, binding = 2, scalar) writeonly buffer Moments2 { vec4 moments_2[]; };
layout(set = 0, binding = 3) uniform utextureBuffer visible_index;
layout(set = 0, binding = 4) uniform textureBuffer gradients;
layout(set = 0, binding = 5, scalar) buffer State { uint state[]; };
// The same memory as the first three: an invocation reads what is its own before it writes it.
layout(set = 0, binding = 6) uniform textureBuffer parameter_texels;
layout(set = 0, binding = 7) uniform textureBuffer moment_1_texels;
layout(set = 0, binding = 8) uniform textureBuffer moment_2_texels;

vec4 parameter_at(uint at) {
    return texelFetch(parameter_texels, int(at));
}

vec4 moment_1_at(uint at) {
    return texelFetch(moment_1_texels, int(at));
}

vec4 moment_2_at(uint at) {
    return texelFetch(moment_2_texels, int(at));
}

vec4 gradient_at(uint at) {
    return texelFetch(gradients, int(at));
}

uint visible_index_at(uint at) {
    return texelFetch(visible_index, int(at)).x;
}

#include "adam.glsl"
