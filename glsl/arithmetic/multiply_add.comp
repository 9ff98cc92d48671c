// Multiply-adds on registers only: the maximum rate of operations in the device's shaders. Reference for compute-bound kernels.
//
// invocation: ROUNDS * STEPS steps of x <- x * factor + term in each of CHAINS independent chains; subgroup, workgroup:
// nothing shared
// out: results[i], one per invocation: the sum of its chains, so that no compiler removes them
// shared: none; any subgroup size (no subgroup operations)
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_control_flow_attributes : require
#extension GL_GOOGLE_include_directive : require

#include "constants.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(constant_id = 2) const uint ROUNDS = 256;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) writeonly buffer Results { float results[]; };

layout(push_constant, scalar) uniform Push {
    uint count;
    float factor;
    float term;
};

#include "dispatch.glsl"

void main() {
    uint index = linear_workgroup() * WORKGROUP_SIZE + gl_LocalInvocationID.x;
    float chains[MULTIPLY_ADD_CHAINS];
    [[unroll]] for (uint c = 0; c < MULTIPLY_ADD_CHAINS; ++c) {
        chains[c] = float(index % 256 + c);
    }
    for (uint k = 0; k < ROUNDS; ++k) {
        [[unroll]] for (uint step = 0; step < MULTIPLY_ADD_STEPS; ++step) {
            [[unroll]] for (uint c = 0; c < MULTIPLY_ADD_CHAINS; ++c) {
                chains[c] = chains[c] * factor + term;
            }
        }
    }
    float sum = 0.0;
    [[unroll]] for (uint c = 0; c < MULTIPLY_ADD_CHAINS; ++c) {
        sum += chains[c];
    }
    if (index < count) {
        results[index] = sum;
    }
}
