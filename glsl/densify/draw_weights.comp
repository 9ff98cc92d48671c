// Weights of a draw in proportion to opacity (3DGS-MCMC, Kheradmand et al. 2024, section 4). They are integers, so that their
// sums are the same in any order, and their total fits 32 bits.
//
// invocation: one Gaussian of a chunk
// in: parameters (PerGaussian planes); out: weights[Gaussian], 0 for those that cannot be drawn; draws[Gaussian] = 0
// shared: none; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require

#include "constants.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) readonly buffer Parameters { vec4 parameters[]; };
layout(set = 0, binding = 1, scalar) writeonly buffer Weights { uint weights[]; };
layout(set = 0, binding = 2, scalar) writeonly buffer Draws { uint draws[]; };

layout(push_constant, scalar) uniform Push {
    uint first;
    uint count;
    // Weight of opacity 1.
    float unit;
    // Gaussians up to this opacity cannot be drawn.
    float least_opacity;
};

#include "dispatch.glsl"
#include "opacity.glsl"
#include "planes.glsl"

void main() {
    uint index = linear_invocation();
    if (index >= count) {
        return;
    }
    float opacity = opacity_of(parameters[geometry_at(PLANE_MEAN_OPACITY, index)].w);
    weights[first + index] = opacity > least_opacity ? max(uint(opacity * unit), 1u) : 0;
    draws[first + index] = 0;
}
