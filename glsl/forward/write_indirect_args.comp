// Clamps a count that only the device knows to its capacity, and writes the indirect arguments of the dispatches over it.
//
// One invocation in all.
// in: state[count_index] = the needed count; 0xFFFFFFFF if it exceeds 32 bits (scan_spine.comp)
// out: state[count_index + 1] = min(needed, capacity); 0 if the prefix sums wrapped around and are invalid;
//      state[STATE_OVERFLOW] is set if the count was clamped;
//      arguments[3]: workgroups for blocks of `block_elementwise`, `block_sort` and `caller_block` elements (the caller is
//      the scan for the visible Gaussians, the duplication for the instances)
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require

#include "constants.glsl"

layout(local_size_x = 1) in;

layout(set = 0, binding = 0, scalar) buffer State { uint state[]; };
layout(set = 0, binding = 1, scalar) writeonly buffer Arguments { uvec4 arguments[]; };

layout(push_constant, scalar) uniform Push {
    uint count_index;
    uint capacity;
    uint first_argument;
    uint block_elementwise;
    uint block_sort;
    uint caller_block;
    uint max_workgroups_per_axis;
};

#include "workgroup_count.glsl"

void main() {
    uint needed = state[count_index];
    bool wrapped = needed == 0xFFFFFFFF;
    uint elements = wrapped ? 0 : min(needed, capacity);
    state[count_index + 1] = elements;
    if (wrapped || needed > capacity) {
        state[STATE_OVERFLOW] = 1;
    }
    arguments[first_argument] = workgroup_count(elements, block_elementwise);
    arguments[first_argument + 1] = workgroup_count(elements, block_sort);
    arguments[first_argument + 2] = workgroup_count(elements, caller_block);
}
