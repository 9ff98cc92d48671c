// Begin and end of each tile's instances in the sorted sequence (paper, section 6; reference identifyTileRanges). With
// FOR_BACKWARD also the visible Gaussian of each sorted instance; without it, the sorted value is the visible Gaussian.
//
// invocation: one sorted instance, compared with its neighbours
// in: sorted_tiles[n]; with FOR_BACKWARD sorted_instances[n] (indices before the tile sort), instance_visible[instance]
// out: tile_ranges[tile] = (begin, end), only for tiles with instances; with FOR_BACKWARD sorted_visible[n]
// shared: none; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require

#include "constants.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(constant_id = 1) const bool FOR_BACKWARD = true;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) readonly buffer State { uint state[]; };
layout(set = 0, binding = 1, scalar) readonly buffer SortedTiles { uint sorted_tiles[]; };
layout(set = 0, binding = 2, scalar) readonly buffer SortedInstances { uint sorted_instances[]; };
layout(set = 0, binding = 3, scalar) readonly buffer InstanceVisible { uint instance_visible[]; };
layout(set = 0, binding = 4, scalar) writeonly buffer TileRanges { uvec2 tile_ranges[]; };
layout(set = 0, binding = 5, scalar) writeonly buffer SortedVisible { uint sorted_visible[]; };

#include "dispatch.glsl"

void main() {
    uint instances = state[STATE_INSTANCES];
    uint index = linear_invocation();
    if (index >= instances) {
        return;
    }
    uint tile = sorted_tiles[index];
    if (FOR_BACKWARD) {
        sorted_visible[index] = instance_visible[sorted_instances[index]];
    }
    if (index == 0 || sorted_tiles[max(index, 1) - 1] != tile) {
        tile_ranges[tile].x = index;
    }
    if (index + 1 == instances || sorted_tiles[min(index + 1, instances - 1)] != tile) {
        tile_ranges[tile].y = index + 1;
    }
}
