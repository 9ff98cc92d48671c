// Histogram of one digit in each block of keys, and its prefix sums over the blocks: first step of a pass of the
// least-significant-digit radix sort (Satish, Harris, Garland 2009).
//
// The workgroups count their arrivals at the end. The last one of a group of blocks scans the group's rows, and the last one of
// all groups scans the rows of the groups. None waits for another, so no forward progress between workgroups is assumed.
//
// invocation: ITEMS keys of its block, then digits; workgroup: one block of WORKGROUP_SIZE * ITEMS keys
// in: keys[n], n = counts[count_index]; in/out: arrivals[SORT_GROUPS + 1], 0 before and after
// out: histogram[row * 2^bits + digit] (sort_rows.glsl), the number of keys with this digit: of a block, in the earlier blocks of
//      its group; of a group, in earlier groups; in all
// shared: 2^bits words and one; any subgroup size (no subgroup operations)
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require

#define SORT_ROWS
#include "constants.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(constant_id = 2) const uint ITEMS = 16;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) readonly buffer Counts { uint counts[]; };
layout(set = 0, binding = 1, scalar) readonly buffer Keys { uint keys[]; };
layout(set = 0, binding = 2, scalar) coherent buffer Histogram { uint histogram[]; };
layout(set = 0, binding = 3, scalar) coherent buffer Arrivals { uint arrivals[]; };

layout(push_constant, scalar) uniform Push {
    uint count_index;
    uint shift;
    uint bits;
};

#include "dispatch.glsl"
#include "sort_rows.glsl"

shared uint bins[SORT_BINS];
shared uint arrived;

// Rows that are read at once, so that their latencies overlap.
const uint AT_ONCE = 16;

// True in the last of `all` workgroups that arrive at a counter, which is then 0 again. What they wrote is visible there.
bool is_last(uint counter, uint all) {
    memoryBarrierBuffer();
    barrier();
    if (gl_LocalInvocationID.x == 0) {
        arrived = atomicAdd(arrivals[counter], 1) + 1;
        if (arrived == all) {
            atomicExchange(arrivals[counter], 0);
        }
    }
    memoryBarrierBuffer();
    barrier();
    memoryBarrierBuffer();
    return arrived == all;
}

// Replaces rows by the sums of those before, and writes the sums of all to another row.
void scan_rows(uint first, uint end, uint sum_row) {
    uint digits = 1u << bits;
    for (uint digit = gl_LocalInvocationID.x; digit < digits; digit += WORKGROUP_SIZE) {
        uint sum = 0;
        for (uint row = first; row < end; row += AT_ONCE) {
            uint keys_of[AT_ONCE];
            [[unroll]] for (uint k = 0; k < AT_ONCE; ++k) {
                keys_of[k] = row + k < end ? histogram[(row + k < end ? row + k : row) * digits + digit] : 0;
            }
            [[unroll]] for (uint k = 0; k < AT_ONCE; ++k) {
                if (row + k < end) {
                    histogram[(row + k) * digits + digit] = sum;
                }
                sum += keys_of[k];
            }
        }
        histogram[sum_row * digits + digit] = sum;
    }
}

void main() {
    const uint block_size = WORKGROUP_SIZE * ITEMS;
    uint n = counts[count_index];
    uint blocks = n / block_size + (n % block_size != 0 ? 1 : 0);
    uint block = linear_workgroup();
    uint digits = 1u << bits;
    // Workgroups after the last block are possible.
    if (block >= blocks) {
        return;
    }
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
    for (uint digit = gl_LocalInvocationID.x; digit < digits; digit += WORKGROUP_SIZE) {
        histogram[block * digits + digit] = bins[digit];
    }
    uint row = group_row(blocks, block);
    uint first = (row - blocks) * blocks_per_group(blocks);
    uint end = min(first + blocks_per_group(blocks), blocks);
    if (is_last(row - blocks, end - first)) {
        scan_rows(first, end, row);
        if (is_last(SORT_GROUPS, total_row(blocks) - blocks)) {
            scan_rows(blocks, total_row(blocks), total_row(blocks));
        }
    }
}
