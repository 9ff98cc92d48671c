// Exclusive prefix sum of the block sums, in place, by a single workgroup: second step of reduce-then-scan.
//
// invocation: ITEMS block sums at a time; workgroup: loops over all sums with a carry
// in/out: block_sums[first_sum ..][m], m = ceil(n / block_size); n = count, or totals[count] when from_totals is set
// out: totals[total_index] = the total, or 0xFFFFFFFF if it exceeds 32 bits: a wrapped total would look like a small one
// out, with ARGUMENTS, where `totals` is the state of a frame: totals[total_index + 1] = min(total, capacity), or 0 if the sums
//      wrapped around and are invalid; totals[STATE_OVERFLOW] is set if that is less than the total; arguments[3]: workgroups
//      for blocks of `block_elementwise`, `block_sort` and `caller_block` elements (the caller is the scan for the visible
//      Gaussians, the duplication for the instances). The first count of a frame, that of the visible Gaussians, clears the rest
//      of the state.
// shared: one word per subgroup; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(constant_id = 1) const uint SUBGROUP_SIZE = 32;
// Fewer rounds mean fewer barriers: an H100 took 32 µs for 17 rounds.
layout(constant_id = 2) const uint ITEMS = 1;
layout(constant_id = 3) const bool ARGUMENTS = false;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) buffer BlockSums { uint block_sums[]; };
layout(set = 0, binding = 1, scalar) buffer Totals { uint totals[]; };
layout(set = 0, binding = 2, scalar) writeonly buffer Arguments { uvec4 arguments[]; };

// If `from_totals` != 0, the number of values is totals[count], otherwise `count`. The sums start at `first_sum`.
layout(push_constant, scalar) uniform Push {
    uint count;
    uint from_totals;
    uint block_size;
    uint total_index;
    uint first_sum;
    uint capacity;
    uint first_argument;
    uint block_elementwise;
    uint block_sort;
    uint caller_block;
    uint max_workgroups_per_axis;
    // If it is not 0, STATE_OVERFLOW is not cleared.
    uint keeps_overflow;
};

#include "constants.glsl"
#include "workgroup_count.glsl"
#include "workgroup_scan.glsl"

void write_arguments(uint total) {
    bool wrapped = total == 0xFFFFFFFF;
    uint elements = wrapped ? 0 : min(total, capacity);
    totals[total_index + 1] = elements;
    for (uint word = STATE_FIRST_SCENE_VISIBLE; word < STATE_WORDS && total_index == STATE_VISIBLE_NEEDED; ++word) {
        if (word != STATE_OVERFLOW || keeps_overflow == 0) {
            totals[word] = 0;
        }
    }
    if (wrapped || total > capacity) {
        totals[STATE_OVERFLOW] = 1;
    }
    arguments[first_argument] = workgroup_count(elements, block_elementwise);
    arguments[first_argument + 1] = workgroup_count(elements, block_sort);
    arguments[first_argument + 2] = workgroup_count(elements, caller_block);
}

void main() {
    uint n = from_totals != 0 ? totals[count] : count;
    uint blocks = n / block_size + (n % block_size != 0 ? 1 : 0);
    uint carry = 0;
    bool saturated = false;
    for (uint first = 0; first < blocks; first += WORKGROUP_SIZE * ITEMS) {
        uint index = first + gl_LocalInvocationID.x * ITEMS;
        uint values[ITEMS];
        // Sums of 16-bit halves, which cannot wrap.
        uint low_sum = 0;
        uint high_sum = 0;
        [[unroll]] for (uint k = 0; k < ITEMS; ++k) {
            bool exists = index + k < blocks;
            values[k] = exists ? block_sums[first_sum + (exists ? index + k : 0)] : 0;
            low_sum += values[k] & 0xFFFF;
            high_sum += values[k] >> 16;
        }
        uint low_total;
        uint high_total;
        uint low = workgroup_exclusive_add(low_sum, low_total);
        uint high = workgroup_exclusive_add(high_sum, high_total);
        [[unroll]] for (uint k = 0; k < ITEMS; ++k) {
            if (index + k < blocks) {
                block_sums[first_sum + index + k] = carry + (high << 16) + low;
            }
            low += values[k] & 0xFFFF;
            high += values[k] >> 16;
        }
        uint next = carry + (high_total << 16) + low_total;
        saturated = saturated || high_total + (low_total >> 16) > 0xFFFF || next < carry;
        carry = next;
    }
    if (gl_LocalInvocationID.x == 0) {
        uint total = saturated ? 0xFFFFFFFF : carry;
        totals[total_index] = total;
        if (ARGUMENTS) {
            write_arguments(total);
        }
    }
}
