// Visible Gaussians of each parameter range of all scenes, and the indirect arguments of the dispatches over them.
//
// invocation: one scene, it loops over its ranges; workgroup: WORKGROUP_SIZE scenes
// in: scene_blocks[scene]; block_offsets[block]: visible Gaussians before each culling block; state[STATE_VISIBLE]
// out, at each range's first block b: visible_ranges[2 b] = workgroups (x, y, z, 0), visible_ranges[2 b + 1] = (first
//      visible, one past the last, 0, 0); state[STATE_FIRST_SCENE_VISIBLE]
// shared: none; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require

#include "constants.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 64;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) buffer State { uint state[]; };
layout(set = 0, binding = 1, scalar) readonly buffer BlockOffsets { uint block_offsets[]; };
layout(set = 0, binding = 2, scalar) writeonly buffer VisibleRanges { uvec4 visible_ranges[]; };

layout(push_constant, scalar) uniform Push {
    uint scenes;
    // Number of culling blocks in the frame.
    uint blocks;
    // Elements per culling block, and per workgroup of the dispatches.
    uint block_elementwise;
    uint max_workgroups_per_axis;
};

#define SCENE_BLOCKS 3
#include "scene_blocks.glsl"
#include "dispatch.glsl"
#include "workgroup_count.glsl"

void main() {
    uint scene = linear_invocation();
    bool exists = scene < scenes;
    uint place = exists ? scene : 0;
    uint count = exists ? scene_blocks[place].scene_count : 0;
    uint first_block = scene_blocks[place].scene_first / block_elementwise;
    uint last_block = first_block + (count + block_elementwise - 1) / block_elementwise;
    uint blocks_per_range = scene_blocks[place].scene_chunk_gaussians / block_elementwise;
    uint visible = state[STATE_VISIBLE];
    uint end = 0;
    for (uint begin_block = first_block; begin_block < last_block; begin_block += blocks_per_range) {
        uint end_block = min(begin_block + blocks_per_range, last_block);
        uint begin = min(block_offsets[begin_block], visible);
        uint next = block_offsets[end_block < blocks ? end_block : begin_block];
        end = end_block < blocks ? min(next, visible) : visible;
        visible_ranges[2 * begin_block] = workgroup_count(end - begin, block_elementwise);
        visible_ranges[2 * begin_block + 1] = uvec4(begin, end, 0, 0);
    }
    // The first scene has the first visible Gaussians.
    if (scene == 0) {
        state[STATE_FIRST_SCENE_VISIBLE] = end;
    }
}
