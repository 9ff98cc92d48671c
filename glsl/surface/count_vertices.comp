// Number of vertices of the mesh on each voxel's edges: first step of marching cubes (Lorensen and Cline 1987).
//
// invocation: one voxel; in: neighbours, distances; out, per voxel: counts, 0 to 3
// shared: none; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require

#define FIELD
#include "constants.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 2, scalar) writeonly buffer Counts { uint counts[]; };

#include "field.glsl"
#include "dispatch.glsl"

void main() {
    uint voxel = linear_invocation();
    if (voxel < voxels) {
        counts[voxel] = bitCount(crossings_of(voxel));
    }
}
