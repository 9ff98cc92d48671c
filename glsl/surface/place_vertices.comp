// Vertices of the mesh: where the distance is 0 on an edge, if it is linear.
//
// invocation: one voxel; in: neighbours, distances, blocks, per voxel colors (integrate.comp), and firsts, the prefix sum of
//     count_vertices.comp; out, per vertex: positions, world units; vertex_colors, RGBA8 (alpha 255)
// shared: none; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require

#define FIELD
#include "constants.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 2, scalar) readonly buffer Blocks { ivec4 blocks[]; };
layout(set = 0, binding = 3, scalar) readonly buffer Colors { uvec2 colors[]; };
layout(set = 0, binding = 4, scalar) readonly buffer Firsts { uint firsts[]; };
layout(set = 0, binding = 5, scalar) writeonly buffer Positions { vec3 positions[]; };
layout(set = 0, binding = 6, scalar) writeonly buffer VertexColors { uint vertex_colors[]; };

#include "field.glsl"
#include "dispatch.glsl"

void main() {
    uint voxel = linear_invocation();
    if (voxel >= voxels) {
        return;
    }
    uint crossings = crossings_of(voxel);
    uint vertex = firsts[voxel];
    vec3 corner = vec3(blocks[voxel / FIELD_VOXELS].xyz * int(FIELD_SIDE) + ivec3(place_in_block(voxel)));
    for (uint axis = 0; axis < 3; ++axis) {
        if ((crossings >> axis & 1) == 0) {
            continue;
        }
        uvec3 along = corner_offset(1 << axis);
        uint other = voxel_beside(voxel, along);
        float share = distance_of(voxel) / (distance_of(voxel) - distance_of(other));
        positions[vertex] = voxel_size * (corner + share * vec3(along));
        vec4 near = vec4(unpackHalf2x16(colors[voxel].x), unpackHalf2x16(colors[voxel].y));
        vec4 far = vec4(unpackHalf2x16(colors[other].x), unpackHalf2x16(colors[other].y));
        // A voxel without colour has no weight.
        vec2 weights = vec2(near.w > 0.0 ? 1.0 - share : 0.0, far.w > 0.0 ? share : 0.0) + vec2(1e-6);
        vec3 color = (weights.x * near.xyz + weights.y * far.xyz) / (weights.x + weights.y);
        vertex_colors[vertex] = packUnorm4x8(vec4(color, 1.0));
        vertex += 1;
    }
}
