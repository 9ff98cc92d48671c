// Stable scatter by one digit: last step of a pass of the serial sort (see sort_upsweep_serial).
//
// The counts of the block's runs become the output indices of their next keys. A digit starts after all lower digits, and
// within a digit a run starts after all earlier blocks and runs. Each invocation then processes its keys in order, so the
// pass is stable.
//
// invocation: a run of ITEMS keys; workgroup: a single subgroup, one block of SUBGROUP_SIZE runs
// in: keys[n], values[n], in fours; histogram (exclusive within a digit), digit_totals; run_counts, which is overwritten
// out: sorted_keys[n], sorted_values[n]
// shared: none; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#extension GL_KHR_shader_subgroup_shuffle : require

layout(constant_id = 0) const uint WORKGROUP_SIZE = 32;
layout(constant_id = 1) const uint SUBGROUP_SIZE = 32;
layout(constant_id = 2) const uint ITEMS = 1024;
// The values are the keys' indices (0, 1, 2, ...), and `values` is not read.
layout(constant_id = 3) const bool IDENTITY_VALUES = false;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) readonly buffer Counts { uint counts[]; };
layout(set = 0, binding = 1, scalar) readonly buffer Keys { uvec4 keys[]; };
layout(set = 0, binding = 2, scalar) readonly buffer Values { uvec4 values[]; };
layout(set = 0, binding = 3, scalar) readonly buffer Histogram { uint histogram[]; };
layout(set = 0, binding = 4, scalar) readonly buffer DigitTotals { uint digit_totals[]; };
layout(set = 0, binding = 5, scalar) coherent buffer RunCounts { uvec4 run_counts[]; };
layout(set = 0, binding = 6, scalar) writeonly buffer SortedKeys { uint sorted_keys[]; };
layout(set = 0, binding = 7, scalar) writeonly buffer SortedValues { uint sorted_values[]; };

layout(push_constant, scalar) uniform Push {
    uint count_index;
    uint shift;
    uint bits;
};

#include "dispatch.glsl"

void place_runs(uint block, uint blocks, uint quads) {
    uint digits = 1u << bits;
    uint carry = 0;
    for (uint low = 0; low < quads; low += SUBGROUP_SIZE) {
        uint quad = low + gl_SubgroupInvocationID;
        uvec4 total = uvec4(0);
        uvec4 next = uvec4(0);
        for (uint k = 0; k < 4; ++k) {
            uint digit = quad * 4 + k;
            if (digit < digits) {
                total[k] = digit_totals[digit];
                next[k] = histogram[digit * blocks + block];
            }
        }
        uint sum = total.x + total.y + total.z + total.w;
        uint inclusive = carry + subgroupInclusiveAdd(sum);
        next += inclusive - sum + uvec4(0, total.x, total.x + total.y, total.x + total.y + total.z);
        carry = subgroupShuffle(inclusive, SUBGROUP_SIZE - 1);
        if (quad < quads) {
            for (uint run = 0; run < SUBGROUP_SIZE; ++run) {
                uint at = (block * SUBGROUP_SIZE + run) * quads + quad;
                uvec4 count = run_counts[at];
                run_counts[at] = next;
                next += count;
            }
        }
    }
}

void put(uint row, uint key, uint value) {
    uint digit = (key >> shift) & ((1u << bits) - 1);
    uint place = run_counts[row + digit / 4][digit % 4];
    run_counts[row + digit / 4][digit % 4] = place + 1;
    sorted_keys[place] = key;
    sorted_values[place] = value;
}

void main() {
    const uint block_size = WORKGROUP_SIZE * ITEMS;
    uint n = counts[count_index];
    uint blocks = n / block_size + (n % block_size != 0 ? 1 : 0);
    uint block = linear_workgroup();
    if (block >= blocks) {
        return;
    }
    uint quads = max(1u << bits, 4) / 4;
    place_runs(block, blocks, quads);
    subgroupMemoryBarrierBuffer();
    subgroupBarrier();

    uint row = linear_invocation() * quads;
    uint first = min(linear_invocation() * ITEMS, n);
    uint end = min(first + ITEMS, n);
    for (uint four = first / 4; four < end / 4; ++four) {
        uvec4 key = keys[four];
        uvec4 value = IDENTITY_VALUES ? four * 4 + uvec4(0, 1, 2, 3) : values[four];
        put(row, key.x, value.x);
        put(row, key.y, value.y);
        put(row, key.z, value.z);
        put(row, key.w, value.w);
    }
    // The last run may end inside a group of four keys.
    for (uint index = max(end / 4 * 4, first); index < end; ++index) {
        put(row, keys[index / 4][index % 4], IDENTITY_VALUES ? index : values[index / 4][index % 4]);
    }
}
