// The visible Gaussians of each parameter range of a scene, and the indirect arguments of the dispatches over them.
//
// invocation: one range; workgroup: WORKGROUP_SIZE ranges
// in: block_offsets[block]: visible Gaussians before each culling block; state[STATE_VISIBLE]
// out, at the range's first block b: visible_ranges[2 b] = workgroups (x, y, z, 0), visible_ranges[2 b + 1] = (first
//      visible, one past the last, 0, 0)
// shared: none; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require

#include "constants.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 64;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) readonly buffer State { uint state[]; };
layout(set = 0, binding = 1, scalar) readonly buffer BlockOffsets { uint block_offsets[]; };
layout(set = 0, binding = 2, scalar) writeonly buffer VisibleRanges { uvec4 visible_ranges[]; };

layout(push_constant, scalar) uniform Push {
    uint ranges;
    // Culling blocks in the frame.
    uint blocks;
    // The scene's first block, its number of blocks, and the blocks of each of its ranges except the last.
    uint first_block;
    uint own_blocks;
    uint blocks_per_range;
    // Elements per workgroup of the dispatches.
    uint block_elementwise;
    uint max_workgroups_per_axis;
};

#include "dispatch.glsl"
#include "workgroup_count.glsl"

void main() {
    uint range = linear_invocation();
    bool exists = range < ranges;
    uint begin_block = first_block + (exists ? range * blocks_per_range : 0);
    uint end_block = min(begin_block + blocks_per_range, first_block + own_blocks);
    uint visible = state[STATE_VISIBLE];
    uint begin = min(block_offsets[begin_block], visible);
    uint next = block_offsets[end_block < blocks ? end_block : begin_block];
    uint end = end_block < blocks ? min(next, visible) : visible;
    if (exists) {
        visible_ranges[2 * begin_block] = workgroup_count(end - begin, block_elementwise);
        visible_ranges[2 * begin_block + 1] = uvec4(begin, end, 0, 0);
    }
}
