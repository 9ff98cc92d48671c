// Tiles of each visible Gaussian in depth order, and the prefix sum of their numbers within each block. scan_spine.comp adds the
// blocks' sums, and duplicate_with_tiles.comp both: that assigns the instances.
//
// invocation: ITEMS visible Gaussians; workgroup: one block of WORKGROUP_SIZE * ITEMS of them
// in: order[rank] = visible, tile_lists[visible] (tile_span.glsl)
// out: list_heads[rank] and list_rows[rank] (the words of its list), block_instances[rank]: number of instances of the block's
//      earlier ranks, block_sums[block]
// shared: one word per subgroup; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_control_flow_attributes : require
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require

#include "constants.glsl"
#include "buffers.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(constant_id = 1) const uint SUBGROUP_SIZE = 32;
layout(constant_id = 2) const uint ITEMS = 4;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) readonly buffer State { uint state[]; };
UINT_READS(1, Order, order);
UVEC2_READS(2, TileLists, tile_lists);
layout(set = 0, binding = 3, scalar) writeonly buffer ListHeads { uint list_heads[]; };
layout(set = 0, binding = 4, scalar) writeonly buffer ListRows { uint list_rows[]; };
layout(set = 0, binding = 5, scalar) writeonly buffer BlockInstances { uint block_instances[]; };
layout(set = 0, binding = 6, scalar) writeonly buffer BlockSums { uint block_sums[]; };

#include "dispatch.glsl"
#include "workgroup_scan.glsl"
#include "tile_list.glsl"

// Number of items whose reads are in flight together. Limited, because with many items building the pipeline would take longer
// than a frame.
const uint AT_ONCE = ITEMS < 8 ? ITEMS : 8;

void main() {
    uint n = state[STATE_VISIBLE];
    uint block = linear_workgroup();
    uint first = block * WORKGROUP_SIZE * ITEMS + gl_LocalInvocationID.x;
    uint carry = 0;
    for (uint begin = 0; begin < ITEMS; begin += AT_ONCE) {
        // Reads come first: they are scattered, and their latencies overlap.
        uvec2 lists[AT_ONCE];
        [[unroll]] for (uint k = 0; k < AT_ONCE; ++k) {
            uint rank = first + (begin + k) * WORKGROUP_SIZE;
            bool exists = begin + k < ITEMS && rank < n;
            uvec2 list = UVEC2_AT(tile_lists, exists ? UINT_AT(order, exists ? rank : 0) : 0);
            lists[k] = exists ? list : uvec2(0);
        }
        [[unroll]] for (uint k = 0; k < AT_ONCE; ++k) {
            uint rank = first + (begin + k) * WORKGROUP_SIZE;
            uint total;
            uint before = workgroup_exclusive_add(tiles_met(lists[k]), total);
            if (begin + k < ITEMS && rank < n) {
                list_heads[rank] = lists[k].x;
                list_rows[rank] = lists[k].y;
                block_instances[rank] = carry + before;
            }
            carry += total;
        }
    }
    if (gl_LocalInvocationID.x == 0 && block * WORKGROUP_SIZE * ITEMS < n) {
        block_sums[block] = carry;
    }
}
