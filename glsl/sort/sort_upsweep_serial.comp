// Histograms of one digit in each run of keys, and in each block of runs: first step of a pass of the serial sort.
//
// For processors, which have few lanes, no coalescing and slow atomics. An invocation counts its own consecutive keys in its
// own histogram. So it needs neither atomics nor barriers, and the cache holds both the keys and the histogram.
//
// invocation: a run of ITEMS keys; workgroup: a single subgroup, one block of SUBGROUP_SIZE runs
// in: keys[n], n = counts[count_index], in fours
// out: histogram[digit * blocks + block], blocks = ceil(n / block);
//      run_counts[run * 2^bits + digit] (at least 4 digits, in fours), run = block * SUBGROUP_SIZE + lane
// shared: none; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require

layout(constant_id = 0) const uint WORKGROUP_SIZE = 32;
layout(constant_id = 1) const uint SUBGROUP_SIZE = 32;
layout(constant_id = 2) const uint ITEMS = 1024;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) readonly buffer Counts { uint counts[]; };
layout(set = 0, binding = 1, scalar) readonly buffer Keys { uvec4 keys[]; };
layout(set = 0, binding = 2, scalar) writeonly buffer Histogram { uint histogram[]; };
layout(set = 0, binding = 3, scalar) coherent buffer RunCounts { uvec4 run_counts[]; };

layout(push_constant, scalar) uniform Push {
    uint count_index;
    uint shift;
    uint bits;
};

#include "dispatch.glsl"

void count_key(uint row, uint key) {
    uint digit = (key >> shift) & ((1u << bits) - 1);
    run_counts[row + digit / 4][digit % 4] += 1;
}

void main() {
    const uint block_size = WORKGROUP_SIZE * ITEMS;
    uint n = counts[count_index];
    uint blocks = n / block_size + (n % block_size != 0 ? 1 : 0);
    uint block = linear_workgroup();
    if (block >= blocks) {
        return;
    }
    uint digits = 1u << bits;
    uint quads = max(digits, 4) / 4;
    uint block_rows = block * WORKGROUP_SIZE * quads;
    uint row = block_rows + gl_SubgroupInvocationID * quads;
    for (uint quad = 0; quad < quads; ++quad) {
        run_counts[row + quad] = uvec4(0);
    }
    uint first = min(linear_invocation() * ITEMS, n);
    uint end = min(first + ITEMS, n);
    for (uint four = first / 4; four < end / 4; ++four) {
        uvec4 key = keys[four];
        count_key(row, key.x);
        count_key(row, key.y);
        count_key(row, key.z);
        count_key(row, key.w);
    }
    // The last run may end inside a group of four keys.
    for (uint index = max(end / 4 * 4, first); index < end; ++index) {
        count_key(row, keys[index / 4][index % 4]);
    }
    subgroupMemoryBarrierBuffer();
    subgroupBarrier();
    for (uint quad = gl_SubgroupInvocationID; quad < quads; quad += SUBGROUP_SIZE) {
        uvec4 sum = uvec4(0);
        for (uint run = 0; run < SUBGROUP_SIZE; ++run) {
            sum += run_counts[block_rows + run * quads + quad];
        }
        for (uint digit = 0; digit < min(digits, 4); ++digit) {
            histogram[(quad * 4 + digit) * blocks + block] = sum[digit];
        }
    }
}
