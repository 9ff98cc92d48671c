// Triangles of the mesh, counterclockwise seen from the front. Cubes share the vertices of their edges.
//
// invocation: one voxel, the cube's first corner; in: neighbours, distances, cubes (engine/surface/cubes.rs), per voxel
//     vertex_firsts and triangle_firsts, the prefix sums of both counts; out: triangles, three vertices each
// shared: none; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require

#define FIELD
#include "constants.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 2, scalar) readonly buffer Cubes { uint cubes[]; };
layout(set = 0, binding = 3, scalar) readonly buffer VertexFirsts { uint vertex_firsts[]; };
layout(set = 0, binding = 4, scalar) readonly buffer TriangleFirsts { uint triangle_firsts[]; };
layout(set = 0, binding = 5, scalar) writeonly buffer Triangles { uvec3 triangles[]; };

#include "field.glsl"
#include "dispatch.glsl"

// The vertex on an edge of a cube: corner of the voxel that it belongs to, and 8 times its axis.
uint vertex_on(uint voxel, uint edge) {
    uint owner = voxel_beside(voxel, corner_offset(edge & 7));
    uint before = crossings_of(owner) & ((1 << (edge >> 3)) - 1);
    return vertex_firsts[owner] + bitCount(before);
}

void main() {
    uint voxel = linear_invocation();
    if (voxel >= voxels) {
        return;
    }
    uint first = case_of(voxel) * CUBE_WORDS;
    uint count = cubes[first];
    for (uint k = 0; k < count; ++k) {
        uint edges = cubes[first + 1 + k];
        uvec3 triangle;
        for (uint side = 0; side < 3; ++side) {
            triangle[side] = vertex_on(voxel, edges >> (5 * side) & 31);
        }
        triangles[triangle_firsts[voxel] + k] = triangle;
    }
}
