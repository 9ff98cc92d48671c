// The list of visible Gaussians in the order of the Gaussians (stable), and its inverse.
//
// invocation: every SUBGROUP_SIZE-th Gaussian of a block; subgroup: one block of BLOCK Gaussians, the blocks of cull; it
// keeps a running count, so no barrier is needed
// in: visible_flags[Gaussian], block_offsets[block] (exclusive prefix sums)
// out: visible_list[visible] = Gaussian, visible_index[Gaussian] = visible or NOT_VISIBLE. Gaussians beyond the capacity are
//     not visible: the frame has then overflowed (scan_spine.comp) and is repeated
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

layout(push_constant, scalar) uniform Push {
    uint count;
    // Maximum number of visible Gaussians.
    uint capacity;
};

#include "dispatch.glsl"

void main() {
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
