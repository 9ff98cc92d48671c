// How many tiles each visible Gaussian touches, in depth order.
//
// invocation: one visible Gaussian, walking over its tile rows
// in: order[rank] = visible, mean2d_extent, conic_opacity, footprints
// out: tile_counts[rank], footprints[visible].w = the same count
// shared: none; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require

#include "constants.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) readonly buffer State { uint state[]; };
layout(set = 0, binding = 1, scalar) readonly buffer Order { uint order[]; };
layout(set = 0, binding = 2, scalar) readonly buffer Mean2dExtent { vec4 mean2d_extent[]; };
layout(set = 0, binding = 3, scalar) readonly buffer ConicOpacity { vec4 conic_opacity[]; };
layout(set = 0, binding = 4, scalar) buffer Footprints { uvec4 footprints[]; };
layout(set = 0, binding = 5, scalar) writeonly buffer TileCounts { uint tile_counts[]; };

layout(push_constant, scalar) uniform Push { uint extent; };

#include "dispatch.glsl"
#include "tile_span.glsl"

void main() {
    uint rank = linear_invocation();
    bool exists = rank < state[STATE_VISIBLE];
    if (!exists) {
        return;
    }
    uint visible = order[rank];
    vec4 mean2d = mean2d_extent[visible];
    vec4 conic = conic_opacity[visible];
    uvec4 footprint = footprints[visible];
    uvec2 tiles_x = uvec2(footprint.x & 0xFFFF, footprint.x >> 16);
    uvec2 tiles_y = uvec2(footprint.y & 0xFFFF, footprint.y >> 16);
    uint tiles = 0;
    // A visible Gaussian has at least one row, so the loop can test at its end: see blend.comp.
    uint row = tiles_y.x;
    for (;;) {
        uvec2 span = tile_span(row, mean2d, conic, tiles_x);
        tiles += span.y - span.x;
        row += 1;
        if (row >= tiles_y.y) {
            break;
        }
    }
    tile_counts[rank] = tiles;
    footprints[visible].w = tiles;
}
