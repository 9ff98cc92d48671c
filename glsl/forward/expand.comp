// One (tile, Gaussian) instance per touched tile, in depth order and, within a Gaussian, row by row.
//
// Work is split by instances, so a Gaussian that covers the screen costs no more per invocation than a small one:
// the workgroup finds the Gaussians of its instances by two binary searches, each invocation its own by a short third.
//
// invocation: one instance; workgroup: WORKGROUP_SIZE consecutive instances
// in: order[rank], instance_offsets[rank] (exclusive prefix sums of the tile counts), PerVisible attributes
// out: instance_tiles[instance] (sort keys), instance_visible[instance]; slot_begins[visible] = its first instance
// shared: 2 words; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require

#include "constants.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) readonly buffer State { uint state[]; };
layout(set = 0, binding = 1, scalar) readonly buffer Order { uint order[]; };
layout(set = 0, binding = 2, scalar) readonly buffer InstanceOffsets { uint instance_offsets[]; };
layout(set = 0, binding = 3, scalar) readonly buffer Mean2dExtent { vec4 mean2d_extent[]; };
layout(set = 0, binding = 4, scalar) readonly buffer ConicOpacity { vec4 conic_opacity[]; };
layout(set = 0, binding = 5, scalar) readonly buffer Footprints { uvec4 footprints[]; };
layout(set = 0, binding = 6, scalar) writeonly buffer InstanceTiles { uint instance_tiles[]; };
layout(set = 0, binding = 7, scalar) writeonly buffer InstanceVisible { uint instance_visible[]; };
layout(set = 0, binding = 8, scalar) writeonly buffer SlotBegins { uint slot_begins[]; };

layout(push_constant, scalar) uniform Push {
    uint extent;
    uint tiles_per_row;
};

#include "dispatch.glsl"
#include "tile_span.glsl"

// Ranks that hold the workgroup's first and last instance.
shared uint rank_bounds[2];

// Last rank in [low, high] whose offset is at most `instance`.
uint find_rank(uint instance, uint low, uint high) {
    while (low < high) {
        uint middle = low + (high - low + 1) / 2;
        if (instance_offsets[middle] <= instance) {
            low = middle;
        } else {
            high = middle - 1;
        }
    }
    return low;
}

void main() {
    uint instances = state[STATE_INSTANCES];
    uint visible_count = state[STATE_VISIBLE];
    uint base = linear_workgroup() * WORKGROUP_SIZE;
    uint instance = base + gl_LocalInvocationID.x;
    if (gl_LocalInvocationID.x < 2 && base < instances) {
        uint probe = gl_LocalInvocationID.x == 0 ? base : min(base + WORKGROUP_SIZE, instances) - 1;
        rank_bounds[gl_LocalInvocationID.x] = find_rank(probe, 0, visible_count - 1);
    }
    barrier();
    if (instance < instances) {
        uint rank = find_rank(instance, rank_bounds[0], rank_bounds[1]);
        uint visible = order[rank];
        uint begin = instance_offsets[rank];
        vec4 mean2d = mean2d_extent[visible];
        vec4 conic = conic_opacity[visible];
        uvec4 footprint = footprints[visible];
        uvec2 tiles_x = uvec2(footprint.x & 0xFFFF, footprint.x >> 16);
        uvec2 tiles_y = uvec2(footprint.y & 0xFFFF, footprint.y >> 16);
        uint left = instance - begin;
        uint row = tiles_y.x;
        uvec2 span;
        for (;;) {
            span = tile_span(row, mean2d, conic, tiles_x);
            if (left < span.y - span.x || row + 1 >= tiles_y.y) {
                break;
            }
            left -= span.y - span.x;
            row += 1;
        }
        instance_tiles[instance] = row * tiles_per_row + min(span.x + left, tiles_x.y - 1);
        instance_visible[instance] = visible;
        if (instance == begin) {
            slot_begins[visible] = begin;
        }
    }
}
