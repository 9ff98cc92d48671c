// Histogram of one digit in each block of keys: first step of a pass of the least-significant-digit radix sort
// (Satish, Harris, Garland 2009; reduce-then-scan, so no forward progress between workgroups is assumed).
//
// invocation: ITEMS keys of its block; workgroup: one block of WORKGROUP_SIZE * ITEMS keys
// in: keys[n], n = counts[count_index]; out: histogram[digit * blocks + block], blocks = ceil(n / block)
// shared: 2^bits words; any subgroup size (no subgroup operations)
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require

#include "constants.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(constant_id = 2) const uint ITEMS = 16;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) readonly buffer Counts { uint counts[]; };
layout(set = 0, binding = 1, scalar) readonly buffer Keys { uint keys[]; };
layout(set = 0, binding = 2, scalar) writeonly buffer Histogram { uint histogram[]; };

layout(push_constant, scalar) uniform Push {
    uint count_index;
    uint shift;
    uint bits;
};

#include "dispatch.glsl"

shared uint bins[SORT_BINS];

void main() {
    const uint block_size = WORKGROUP_SIZE * ITEMS;
    uint n = counts[count_index];
    uint blocks = n / block_size + (n % block_size != 0 ? 1 : 0);
    uint block = linear_workgroup();
    uint digits = 1u << bits;
    for (uint digit = gl_LocalInvocationID.x; digit < digits; digit += WORKGROUP_SIZE) {
        bins[digit] = 0;
    }
    barrier();
    [[unroll]] for (uint k = 0; k < ITEMS; ++k) {
        uint index = block * block_size + k * WORKGROUP_SIZE + gl_LocalInvocationID.x;
        uint key = keys[index < n ? index : 0];
        if (index < n) {
            atomicAdd(bins[(key >> shift) & (digits - 1)], 1);
        }
    }
    barrier();
    if (block < blocks) {
        for (uint digit = gl_LocalInvocationID.x; digit < digits; digit += WORKGROUP_SIZE) {
            histogram[digit * blocks + block] = bins[digit];
        }
    }
}
