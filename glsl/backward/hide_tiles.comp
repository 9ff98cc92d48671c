// Empties the tiles of a training view in which its photograph's mask hides every pixel: they are neither blended nor
// differentiated.
//
// workgroup: a tile, a single subgroup
// in: photo, with a mask (passes/loss.rs), by rows or with STRIPS in planes of bytes
// in/out: tile_ranges
// shared: none; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_vote : require

layout(constant_id = 0) const uint WORKGROUP_SIZE = 32;
layout(constant_id = 1) const uint SUBGROUP_SIZE = 32;
layout(constant_id = 2) const bool STRIPS = false;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) readonly buffer Photo { uint photo[]; };
layout(set = 0, binding = 1, scalar) buffer TileRanges { uvec2 tile_ranges[]; };

layout(push_constant, scalar) uniform Push {
    uint image_width;
    uint image_height;
    uint tiles_per_row;
    uint tile_count;
};

#include "constants.glsl"
#include "dispatch.glsl"
#include "strips.glsl"

const uint MASK_PLANE = 3;

// True if the pixel counts. Those outside the picture do not.
bool is_shown(uvec2 at) {
    if (at.x >= image_width || at.y >= image_height) {
        return false;
    }
    uint place = STRIPS ? strip_value(MASK_PLANE, at) : 4 * (at.y * image_width + at.x) + 3;
    return (photo[place / 4] >> 8 * (place % 4) & 0xFFu) != 0;
}

void main() {
    uint tile = linear_workgroup();
    if (tile >= tile_count) {
        return;
    }
    uvec2 range = tile_ranges[tile];
    uvec2 origin = TILE_SIZE * uvec2(tile % tiles_per_row, tile / tiles_per_row);
    // Most tiles show one of their first pixels, so the loop ends at once.
    bool hidden = range.x < range.y;
    for (uint pixel = 0; hidden && pixel < TILE_SIZE * TILE_SIZE; pixel += SUBGROUP_SIZE) {
        uint own = pixel + gl_SubgroupInvocationID;
        hidden = !subgroupAny(is_shown(origin + uvec2(own % TILE_SIZE, own / TILE_SIZE)));
    }
    if (hidden && gl_SubgroupInvocationID == 0) {
        tile_ranges[tile] = uvec2(0);
    }
}
