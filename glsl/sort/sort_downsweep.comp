// Stable scatter by one digit: last step of a radix sort pass.
//
// Each subgroup owns a contiguous run of its block's keys. Matching lanes, round by round, gives each key its rank among the
// run's keys of its digit. Runs, blocks and digits are processed in order, so the pass is stable. First, shared memory orders
// the block's pairs by digit, so that neighbouring lanes store to neighbouring places. On an H100 a pass over 2^20 pairs takes
// 17 µs, and 44 µs without that.
//
// invocation: ITEMS keys; subgroup: a run of SUBGROUP_SIZE * ITEMS keys; workgroup: one block
// in: keys[n], values[n], histogram (sort_rows.glsl); out: sorted_keys[n], sorted_values[n]
// shared: one word per key of the block, or per subgroup and digit if those are more; one per digit; subgroup sizes 4 to 128
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#extension GL_KHR_shader_subgroup_ballot : require
#extension GL_KHR_shader_subgroup_shuffle : require

#define SORT_ROWS
#include "constants.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(constant_id = 1) const uint SUBGROUP_SIZE = 32;
layout(constant_id = 2) const uint ITEMS = 16;
// The values are the keys' indices (0, 1, 2, ...), and `values` is not read.
layout(constant_id = 3) const bool IDENTITY_VALUES = false;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) readonly buffer Counts { uint counts[]; };
layout(set = 0, binding = 1, scalar) readonly buffer Keys { uint keys[]; };
layout(set = 0, binding = 2, scalar) readonly buffer Values { uint values[]; };
layout(set = 0, binding = 3, scalar) readonly buffer Histogram { uint histogram[]; };
layout(set = 0, binding = 4, scalar) writeonly buffer SortedKeys { uint sorted_keys[]; };
layout(set = 0, binding = 5, scalar) writeonly buffer SortedValues { uint sorted_values[]; };

layout(push_constant, scalar) uniform Push {
    uint count_index;
    uint shift;
    uint bits;
};

#include "dispatch.glsl"
#include "match_key.glsl"
#include "sort_rows.glsl"
#include "workgroup_scan.glsl"

const uint BLOCK = WORKGROUP_SIZE * ITEMS;
const uint SUBGROUPS = WORKGROUP_SIZE / SUBGROUP_SIZE;
const uint RUN_BINS = SUBGROUPS * SORT_BINS;

// Holds first, per subgroup and digit, the count within the run, then the place within the block of the run's first key with
// this digit. Then it holds the block's keys in the order of their digits, then its values.
shared uint scratch[RUN_BINS > BLOCK ? RUN_BINS : BLOCK];
// Per digit: the offset from a key's place within the block to its place in the output. May wrap.
shared uint digit_offsets[SORT_BINS];

uint digit_of(uint key) {
    return (key >> shift) & ((1u << bits) - 1);
}

void main() {
    uint n = counts[count_index];
    uint blocks = n / BLOCK + (n % BLOCK != 0 ? 1 : 0);
    uint block = linear_workgroup();
    uint digits = 1u << bits;
    uint run_base = gl_SubgroupID * SORT_BINS;
    uint first = block * BLOCK + gl_SubgroupID * SUBGROUP_SIZE * ITEMS + gl_SubgroupInvocationID;
    // Workgroups after the last block are possible.
    uint in_block = block < blocks ? min(n - block * BLOCK, BLOCK) : 0;

    uint keys_of[ITEMS];
    [[unroll]] for (uint k = 0; k < ITEMS; ++k) {
        uint index = first + k * SUBGROUP_SIZE;
        keys_of[k] = keys[index < n ? index : 0];
    }
    for (uint digit = gl_SubgroupInvocationID; digit < digits; digit += SUBGROUP_SIZE) {
        scratch[run_base + digit] = 0;
    }
    subgroupMemoryBarrierShared();
    subgroupBarrier();

    // Per key: number of earlier keys of its run and digit, then its place within the block.
    uint places[ITEMS];
    [[unroll]] for (uint k = 0; k < ITEMS; ++k) {
        bool valid = first + k * SUBGROUP_SIZE < n;
        uint digit = digit_of(keys_of[k]);
        uint below;
        uint peers;
        match_key(digit, bits, valid, below, peers);
        uint before = scratch[run_base + digit];
        subgroupMemoryBarrierShared();
        subgroupBarrier();
        // The last of the lanes with the same digit counts them.
        if (valid && below + 1 == peers) {
            scratch[run_base + digit] = before + peers;
        }
        subgroupMemoryBarrierShared();
        subgroupBarrier();
        places[k] = before + below;
    }
    barrier();

    // Start of each digit. Within the block: after all lower digits, and all earlier runs. In the output: after all lower
    // digits, and all earlier blocks.
    uint carry = 0;
    uint block_carry = 0;
    for (uint low = 0; low < digits; low += WORKGROUP_SIZE) {
        uint digit = low + gl_LocalInvocationID.x;
        bool valid = digit < digits;
        uint count = 0;
        if (valid) {
            for (uint run = 0; run < SUBGROUPS; ++run) {
                count += scratch[run * SORT_BINS + digit];
            }
        }
        uint total;
        uint block_total;
        uint keys_of_all = valid && block < blocks ? histogram[valid && block < blocks ? total_row(blocks) * digits + digit : 0] : 0;
        uint output_start = carry + workgroup_exclusive_add(keys_of_all, total);
        uint start = block_carry + workgroup_exclusive_add(count, block_total);
        carry += total;
        block_carry += block_total;
        if (valid && block < blocks) {
            uint earlier = histogram[group_row(blocks, block) * digits + digit] + histogram[block * digits + digit];
            digit_offsets[digit] = output_start + earlier - start;
            for (uint run = 0; run < SUBGROUPS; ++run) {
                uint of_run = scratch[run * SORT_BINS + digit];
                scratch[run * SORT_BINS + digit] = start;
                start += of_run;
            }
        }
    }
    barrier();
    [[unroll]] for (uint k = 0; k < ITEMS; ++k) {
        places[k] += scratch[run_base + digit_of(keys_of[k])];
    }
    barrier();

    [[unroll]] for (uint k = 0; k < ITEMS; ++k) {
        if (first + k * SUBGROUP_SIZE < n) {
            scratch[places[k]] = keys_of[k];
        }
    }
    barrier();
    uint outputs[ITEMS];
    [[unroll]] for (uint k = 0; k < ITEMS; ++k) {
        uint place = k * WORKGROUP_SIZE + gl_LocalInvocationID.x;
        if (place < in_block) {
            uint key = scratch[place];
            outputs[k] = digit_offsets[digit_of(key)] + place;
            sorted_keys[outputs[k]] = key;
        }
    }
    barrier();
    [[unroll]] for (uint k = 0; k < ITEMS; ++k) {
        uint index = first + k * SUBGROUP_SIZE;
        if (index < n) {
            scratch[places[k]] = IDENTITY_VALUES ? index : values[index];
        }
    }
    barrier();
    [[unroll]] for (uint k = 0; k < ITEMS; ++k) {
        uint place = k * WORKGROUP_SIZE + gl_LocalInvocationID.x;
        if (place < in_block) {
            sorted_values[outputs[k]] = scratch[place];
        }
    }
}
