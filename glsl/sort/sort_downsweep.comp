// Stable scatter by one digit: last step of a radix sort pass.
//
// Each subgroup owns a contiguous run of its block's keys and counts its digits. Matching lanes, round by round, then gives the
// places behind the run's first. Runs, blocks and digits are processed in order, so the pass is stable. Keys are read twice:
// to keep them and their ranks takes 2 ITEMS registers, which one driver puts into memory (tools/gpu_static.md).
//
// invocation: ITEMS keys; subgroup: a run of SUBGROUP_SIZE * ITEMS keys; workgroup: one block
// in: keys[n], values[n], histogram (exclusive within a digit), digit_totals; out: sorted_keys[n], sorted_values[n]
// shared: (subgroups + 1) * 2^bits words; subgroup sizes 4 to 128
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#extension GL_KHR_shader_subgroup_ballot : require
#extension GL_KHR_shader_subgroup_shuffle : require

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
layout(set = 0, binding = 4, scalar) readonly buffer DigitTotals { uint digit_totals[]; };
layout(set = 0, binding = 5, scalar) writeonly buffer SortedKeys { uint sorted_keys[]; };
layout(set = 0, binding = 6, scalar) writeonly buffer SortedValues { uint sorted_values[]; };

layout(push_constant, scalar) uniform Push {
    uint count_index;
    uint shift;
    uint bits;
};

#include "dispatch.glsl"
#include "subgroup.glsl"
#include "workgroup_scan.glsl"

const uint SUBGROUPS = WORKGROUP_SIZE / SUBGROUP_SIZE;

// Per subgroup and digit: first the count within the run, then the output index of the run's next key with this digit.
shared uint run_bins[SUBGROUPS * SORT_BINS];

uint digit_of(uint key) {
    return (key >> shift) & ((1u << bits) - 1);
}

void main() {
    const uint block_size = WORKGROUP_SIZE * ITEMS;
    uint n = counts[count_index];
    uint blocks = n / block_size + (n % block_size != 0 ? 1 : 0);
    uint block = linear_workgroup();
    uint digits = 1u << bits;
    uint run_base = gl_SubgroupID * SORT_BINS;
    uint first = block * block_size + gl_SubgroupID * SUBGROUP_SIZE * ITEMS + gl_SubgroupInvocationID;

    for (uint digit = gl_SubgroupInvocationID; digit < digits; digit += SUBGROUP_SIZE) {
        run_bins[run_base + digit] = 0;
    }
    subgroupMemoryBarrierShared();
    subgroupBarrier();

    [[unroll]] for (uint k = 0; k < ITEMS; ++k) {
        uint index = first + k * SUBGROUP_SIZE;
        if (index < n) {
            atomicAdd(run_bins[run_base + digit_of(keys[index])], 1);
        }
    }
    // For the lanes of one subgroup: if there are several, the prefix sum has a barrier.
    subgroupMemoryBarrierShared();
    subgroupBarrier();

    // Start of each digit: after all lower digits, all earlier blocks, and all earlier runs.
    uint carry = 0;
    for (uint low = 0; low < digits; low += WORKGROUP_SIZE) {
        uint digit = low + gl_LocalInvocationID.x;
        bool valid = digit < digits;
        uint total;
        uint start = carry + workgroup_exclusive_add(valid ? digit_totals[valid ? digit : 0] : 0, total);
        carry += total;
        if (valid && block < blocks) {
            start += histogram[digit * blocks + block];
            for (uint run = 0; run < SUBGROUPS; ++run) {
                uint count = run_bins[run * SORT_BINS + digit];
                run_bins[run * SORT_BINS + digit] = start;
                start += count;
            }
        }
    }
    barrier();

    uint next_key = keys[first < n ? first : 0];
    uint next_value = IDENTITY_VALUES ? first : values[first < n ? first : 0];
    for (uint k = 0; k < ITEMS; ++k) {
        uint index = first + k * SUBGROUP_SIZE;
        bool valid = index < n;
        uint key = next_key;
        uint value = next_value;
        // The next round's, so that they are there in time.
        uint next = index + SUBGROUP_SIZE;
        bool next_valid = k + 1 < ITEMS && next < n;
        next_key = keys[next_valid ? next : 0];
        next_value = IDENTITY_VALUES ? next : values[next_valid ? next : 0];
        uint digit = digit_of(key);
        uint below;
        uint peers;
        match_key(digit, bits, valid, below, peers);
        uint before = run_bins[run_base + digit];
        subgroupMemoryBarrierShared();
        subgroupBarrier();
        // The last of the lanes with the same digit moves the place on.
        if (valid && below + 1 == peers) {
            run_bins[run_base + digit] = before + peers;
        }
        subgroupMemoryBarrierShared();
        subgroupBarrier();
        if (valid) {
            sorted_keys[before + below] = key;
            sorted_values[before + below] = value;
        }
    }
}
