// Source of each row of the new set. First come the Gaussians that stay, then the clones, then the first and the second halves
// of split Gaussians. Each part keeps the old order (the reference's order after its prune).
//
// invocation: one Gaussian; workgroup: one block of WORKGROUP_SIZE Gaussians, the same blocks as in classify
// in: decisions[Gaussian], block_offsets[decision * blocks + block], totals[3]
// out: sources[row] = Gaussian | kind << KIND_SHIFT; rows beyond the capacity are dropped
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

layout(set = 0, binding = 0, scalar) readonly buffer Decisions { uint decisions[]; };
layout(set = 0, binding = 1, scalar) readonly buffer BlockOffsets { uint block_offsets[]; };
layout(set = 0, binding = 2, scalar) readonly buffer Totals { uint totals[]; };
layout(set = 0, binding = 3, scalar) writeonly buffer Sources { uint sources[]; };

layout(push_constant, scalar) uniform Push {
    uint count;
    uint blocks;
    uint capacity;
};

#include "dispatch.glsl"
#include "workgroup_scan.glsl"

void write_source(bool wanted, uint row, uint source, uint kind) {
    if (wanted && row < capacity) {
        sources[row] = source | kind << KIND_SHIFT;
    }
}

void main() {
    uint index = linear_invocation();
    bool exists = index < count;
    uint decision = exists ? decisions[exists ? index : 0] : 0;
    uint block = (exists ? index : 0) / WORKGROUP_SIZE;
    uint stays = decision & 1;
    uint cloned = decision >> 1 & 1;
    uint split = decision >> 2 & 1;
    uint total;
    uint row_stays = workgroup_exclusive_add(stays, total) + block_offsets[block];
    uint row_cloned = workgroup_exclusive_add(cloned, total) + block_offsets[blocks + block] + totals[0];
    uint row_split = workgroup_exclusive_add(split, total) + block_offsets[2 * blocks + block] + totals[0] + totals[1];
    write_source(stays != 0, row_stays, index, KIND_KEPT);
    write_source(cloned != 0, row_cloned, index, KIND_CLONE);
    write_source(split != 0, row_split, index, KIND_SPLIT_0);
    write_source(split != 0, row_split + totals[2], index, KIND_SPLIT_1);
}
