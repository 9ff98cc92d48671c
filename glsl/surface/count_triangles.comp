// Number of triangles of the mesh in each cube of eight voxels.
//
// invocation: one voxel, the cube's first corner; in: neighbours, distances, cubes (engine/surface/cubes.rs); out, per voxel: counts
// shared: none; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require

#define FIELD
#include "constants.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 2, scalar) readonly buffer Cubes { uint cubes[]; };
layout(set = 0, binding = 3, scalar) writeonly buffer Counts { uint counts[]; };

#include "field.glsl"
#include "dispatch.glsl"

void main() {
    uint voxel = linear_invocation();
    if (voxel < voxels) {
        counts[voxel] = cubes[case_of(voxel) * CUBE_WORDS];
    }
}
