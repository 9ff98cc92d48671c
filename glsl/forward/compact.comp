// The list of visible Gaussians in the order of the Gaussians (stable), and its inverse. Also the visible Gaussians of each
// parameter range of all scenes, and the indirect arguments of the dispatches over them.
//
// invocation: every SUBGROUP_SIZE-th Gaussian of a block, and the ranges of one scene; subgroup: one block of BLOCK Gaussians,
// the blocks of cull; it keeps a running count, so no barrier is needed
// in: visible_flags[Gaussian], block_offsets[block] (exclusive prefix sums), scene_blocks[scene], state[STATE_VISIBLE]
// out: visible_list[visible] = Gaussian, visible_index[Gaussian] = visible or NOT_VISIBLE. Gaussians beyond the capacity are
//     not visible: the frame has then overflowed (scan_spine.comp) and is repeated.
//     At each range's first block b: visible_ranges[2 b] = workgroups (x, y, z, 0), visible_ranges[2 b + 1] = (first visible,
//     one past the last, 0, 0); state[STATE_FIRST_SCENE_VISIBLE]
// shared: none; subgroup sizes 4 to 128
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_ballot : require

#include "constants.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(constant_id = 1) const uint SUBGROUP_SIZE = 32;
// A multiple of SUBGROUP_SIZE.
layout(constant_id = 2) const uint BLOCK = 256;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) readonly buffer VisibleFlags { uint visible_flags[]; };
layout(set = 0, binding = 1, scalar) readonly buffer BlockOffsets { uint block_offsets[]; };
layout(set = 0, binding = 2, scalar) writeonly buffer VisibleList { uint visible_list[]; };
layout(set = 0, binding = 3, scalar) writeonly buffer VisibleIndex { uint visible_index[]; };
layout(set = 0, binding = 4, scalar) buffer State { uint state[]; };
layout(set = 0, binding = 5, scalar) writeonly buffer VisibleRanges { uvec4 visible_ranges[]; };

layout(push_constant, scalar) uniform Push {
    uint count;
    // Maximum number of visible Gaussians.
    uint capacity;
    uint scenes;
    uint max_workgroups_per_axis;
};

#define SCENE_BLOCKS 6
#include "scene_blocks.glsl"
#include "dispatch.glsl"
#include "workgroup_count.glsl"

void write_ranges(uint scene) {
    uint blocks = (count + BLOCK - 1) / BLOCK;
    uint first_block = scene_blocks[scene].scene_first / BLOCK;
    uint last_block = first_block + (scene_blocks[scene].scene_count + BLOCK - 1) / BLOCK;
    uint blocks_per_range = scene_blocks[scene].scene_chunk_gaussians / BLOCK;
    uint visible = state[STATE_VISIBLE];
    uint end = 0;
    for (uint begin_block = first_block; begin_block < last_block; begin_block += blocks_per_range) {
        uint end_block = min(begin_block + blocks_per_range, last_block);
        uint begin = min(block_offsets[begin_block], visible);
        uint next = block_offsets[end_block < blocks ? end_block : begin_block];
        end = end_block < blocks ? min(next, visible) : visible;
        visible_ranges[2 * begin_block] = workgroup_count(end - begin, BLOCK);
        visible_ranges[2 * begin_block + 1] = uvec4(begin, end, 0, 0);
    }
    // The first scene has the first visible Gaussians.
    if (scene == 0) {
        state[STATE_FIRST_SCENE_VISIBLE] = end;
    }
}

void main() {
    if (linear_invocation() < scenes) {
        write_ranges(linear_invocation());
    }
    uint block = linear_workgroup() * (WORKGROUP_SIZE / SUBGROUP_SIZE) + gl_SubgroupID;
    uint index = block * BLOCK + gl_SubgroupInvocationID;
    if (block * BLOCK >= count) {
        return;
    }
    uint visible = block_offsets[block];
    for (uint k = 0; k < BLOCK / SUBGROUP_SIZE; ++k) {
        bool exists = index < count;
        bool flag = exists && visible_flags[exists ? index : 0] != 0;
        uvec4 ballot = subgroupBallot(flag);
        uint place = visible + subgroupBallotExclusiveBitCount(ballot);
        bool fits = flag && place < capacity;
        if (fits) {
            visible_list[place] = index;
        }
        if (exists) {
            visible_index[index] = fits ? place : NOT_VISIBLE;
        }
        visible += subgroupBallotBitCount(ballot);
        index += SUBGROUP_SIZE;
    }
}
