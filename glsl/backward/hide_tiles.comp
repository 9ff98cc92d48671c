// Empties the tiles of a training view in which its photograph's mask hides every pixel: they are neither blended nor
// differentiated. Their instances get gradients of 0 here.
//
// workgroup: a tile, a single subgroup
// in: photo, with a mask (passes/loss.rs), by rows or with STRIPS in planes of bytes; sorted_instances
// in/out: tile_ranges; out, only of hidden tiles: instance_gradients_a to _d
// shared: none; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_vote : require

layout(constant_id = 0) const uint WORKGROUP_SIZE = 32;
layout(constant_id = 1) const uint SUBGROUP_SIZE = 32;
layout(constant_id = 2) const bool STRIPS = false;
// There are absolute gradients, in instance_gradients_d.
layout(constant_id = 3) const bool ABSOLUTE = false;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) readonly buffer Photo { uint photo[]; };
layout(set = 0, binding = 1, scalar) readonly buffer SortedInstances { uint sorted_instances[]; };
layout(set = 0, binding = 2, scalar) buffer TileRanges { uvec2 tile_ranges[]; };
layout(set = 0, binding = 3, scalar) writeonly buffer InstanceGradientsA { vec4 instance_gradients_a[]; };
layout(set = 0, binding = 4, scalar) writeonly buffer InstanceGradientsB { vec4 instance_gradients_b[]; };
layout(set = 0, binding = 5, scalar) writeonly buffer InstanceGradientsC { vec2 instance_gradients_c[]; };
layout(set = 0, binding = 6, scalar) writeonly buffer InstanceGradientsD { vec2 instance_gradients_d[]; };

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
    if (!hidden) {
        return;
    }
    for (uint index = range.x + gl_SubgroupInvocationID; index < range.y; index += SUBGROUP_SIZE) {
        uint instance = sorted_instances[index];
        instance_gradients_a[instance] = vec4(0.0);
        instance_gradients_b[instance] = vec4(0.0);
        instance_gradients_c[instance] = vec2(0.0);
        if (ABSOLUTE) {
            instance_gradients_d[instance] = vec2(0.0);
        }
    }
    if (gl_SubgroupInvocationID == 0) {
        tile_ranges[tile] = uvec2(0);
    }
}
