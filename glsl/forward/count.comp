// How many tiles each visible Gaussian touches, in depth order, and the sums of blocks of them: first step of the prefix
// sum that gives each Gaussian its instances (scan_reduce.comp, with a gather).
//
// invocation: ITEMS visible Gaussians; workgroup: one block of WORKGROUP_SIZE * ITEMS of them, a block of the scan
// in: order[rank] = visible, visible_tiles[visible]
// out: tile_counts[rank], block_sums[block]
// shared: one word per subgroup; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require

#include "constants.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(constant_id = 1) const uint SUBGROUP_SIZE = 32;
layout(constant_id = 2) const uint ITEMS = 4;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) readonly buffer State { uint state[]; };
layout(set = 0, binding = 1, scalar) readonly buffer Order { uint order[]; };
layout(set = 0, binding = 2, scalar) readonly buffer VisibleTiles { uint visible_tiles[]; };
layout(set = 0, binding = 3, scalar) writeonly buffer TileCounts { uint tile_counts[]; };
layout(set = 0, binding = 4, scalar) writeonly buffer BlockSums { uint block_sums[]; };

#include "dispatch.glsl"
#include "workgroup_scan.glsl"

void main() {
    uint n = state[STATE_VISIBLE];
    uint block = linear_workgroup();
    uint first = block * WORKGROUP_SIZE * ITEMS + gl_LocalInvocationID.x;
    uint sum = 0;
    for (uint k = 0; k < ITEMS; ++k) {
        uint rank = first + k * WORKGROUP_SIZE;
        bool exists = rank < n;
        uint tiles = exists ? visible_tiles[order[exists ? rank : 0]] : 0;
        if (exists) {
            tile_counts[rank] = tiles;
        }
        sum += tiles;
    }
    uint total;
    workgroup_exclusive_add(sum, total);
    if (gl_LocalInvocationID.x == 0 && block * WORKGROUP_SIZE * ITEMS < n) {
        block_sums[block] = total;
    }
}
