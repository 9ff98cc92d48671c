// Adds each Gaussian's importance in a view to its mean over views: the weight, scaled from 0 (smallest of all Gaussians) to 1
// (largest); 0 if all are equal (Improved-GS).
//
// invocation: one Gaussian
// in: state, weights, ranges (sum_weights.comp)
// in/out: importance[Gaussian]; it stays if the frame overflowed
// shared: none; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require

#include "constants.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) readonly buffer State { uint state[]; };
layout(set = 0, binding = 1, scalar) readonly buffer Weights { float weights[]; };
layout(set = 0, binding = 2, scalar) readonly buffer Ranges { uint ranges[]; };
layout(set = 0, binding = 3, scalar) buffer Importance { float importance[]; };

layout(push_constant, scalar) uniform Push {
    uint count;
    // 1 / number of views.
    float share;
};

#include "dispatch.glsl"
#include "edges.glsl"

void main() {
    uint index = linear_invocation();
    if (index >= count || state[STATE_OVERFLOW] != 0) {
        return;
    }
    float low = uintBitsToFloat(~ranges[RANGE_WEIGHT_LOW]);
    float high = uintBitsToFloat(ranges[RANGE_WEIGHT_HIGH]);
    float span = high - low;
    importance[index] += span > 0.0 ? share * ((weights[index] - low) / span) : 0.0;
}
