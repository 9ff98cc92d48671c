// Opacities as sort keys, the faintest first. An opacity is a nonnegative float, so its bits sort like its value.
//
// invocation: one Gaussian of a chunk
// in: parameters (PerGaussian planes); out: keys[Gaussian] = bits of the opacity
// shared: none; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require

#include "constants.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) readonly buffer Parameters { vec4 parameters[]; };
layout(set = 0, binding = 1, scalar) writeonly buffer Keys { uint keys[]; };

layout(push_constant, scalar) uniform Push {
    uint first;
    uint count;
};

#include "dispatch.glsl"
#include "opacity.glsl"
#include "planes.glsl"

void main() {
    uint index = linear_invocation();
    if (index >= count) {
        return;
    }
    keys[first + index] = floatBitsToUint(opacity_of(parameters[geometry_at(PLANE_MEAN_OPACITY, index)].w));
}
