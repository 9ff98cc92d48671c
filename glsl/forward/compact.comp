// The list of visible Gaussians in their own order (stable), and its inverse.
//
// invocation: one Gaussian; workgroup: one block of WORKGROUP_SIZE Gaussians, the same blocks as in cull
// in: visible_flags[Gaussian], block_offsets[block] (exclusive prefix sums)
// out: visible_list[visible] = Gaussian, visible_index[Gaussian] = visible or NOT_VISIBLE
// shared: one word per subgroup; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require

#include "constants.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(constant_id = 1) const uint SUBGROUP_SIZE = 32;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) readonly buffer VisibleFlags { uint visible_flags[]; };
layout(set = 0, binding = 1, scalar) readonly buffer BlockOffsets { uint block_offsets[]; };
layout(set = 0, binding = 2, scalar) writeonly buffer VisibleList { uint visible_list[]; };
layout(set = 0, binding = 3, scalar) writeonly buffer VisibleIndex { uint visible_index[]; };

layout(push_constant, scalar) uniform Push { uint count; };

#include "dispatch.glsl"
#include "workgroup_scan.glsl"

void main() {
    uint index = linear_invocation();
    bool exists = index < count;
    uint flag = exists ? visible_flags[exists ? index : 0] : 0;
    uint total;
    uint place = workgroup_exclusive_add(flag, total) + block_offsets[(exists ? index : 0) / WORKGROUP_SIZE];
    if (flag != 0) {
        visible_list[place] = index;
    }
    if (exists) {
        visible_index[index] = flag != 0 ? place : NOT_VISIBLE;
    }
}
