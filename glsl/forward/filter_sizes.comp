// Size of Mip-Splatting's 3D filter from the depths of nearest_depths.comp. Gaussians that no camera shows take the largest
// depth of the visible ones.
//
// invocation: one Gaussian of a chunk
// in: farthest; in/out: parameters (PerGaussian planes): log_scale.w, a depth, becomes the filter's standard deviation,
//     world units. Nothing changes if the frame overflowed.
// shared: none; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require

#include "constants.glsl"
#include "buffers.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) buffer Parameters { vec4 parameters[]; };
UINT_READS(1, State, state);
UINT_READS(2, Farthest, farthest);

layout(push_constant, scalar) uniform Push {
    uint count;
    // Standard deviation per depth.
    float size_per_depth;
};

#include "dispatch.glsl"
#include "planes.glsl"

void main() {
    uint index = linear_invocation();
    if (index >= count || UINT_AT(state, STATE_OVERFLOW) != 0) {
        return;
    }
    uint at = geometry_at(PLANE_LOG_SCALE, index);
    float nearest = parameters[at].w;
    parameters[at].w = (nearest > 0.0 ? nearest : uintBitsToFloat(UINT_AT(farthest, 0))) * size_per_depth;
}
