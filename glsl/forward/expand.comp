// One (tile, Gaussian) instance per touched tile, in depth order and, within a Gaussian, row by row.
//
// Work is split by instances, so a Gaussian that covers the screen costs no more per invocation than a small one. A
// subgroup searches the Gaussian of its first instance, then goes through the ranks: each lane fetches one Gaussian, and
// the instances of these Gaussians are dealt to the lanes, which get their Gaussian by shuffles.
//
// invocation: ITEMS instances; subgroup: a run of SUBGROUP_SIZE * ITEMS consecutive instances
// in: order[rank], instance_offsets[rank] (exclusive prefix sums of the tile counts), PerVisible: mean2d_extent, footprints
// out: instance_tiles[instance] (sort keys), instance_visible[instance]; with SLOTS slot_begins[visible] = its first
//      instance
// shared: none; subgroup sizes 4 to 128
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_control_flow_attributes : require
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_ballot : require
#extension GL_KHR_shader_subgroup_shuffle : require

#include "constants.glsl"
#include "buffers.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(constant_id = 1) const uint SUBGROUP_SIZE = 32;
layout(constant_id = 2) const uint ITEMS = 16;
layout(constant_id = 3) const bool SLOTS = true;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) readonly buffer State { uint state[]; };
UINT_READS(1, Order, order);
UINT_READS(2, InstanceOffsets, instance_offsets);
VEC4_READS(3, Mean2dExtent, mean2d_extent);
UVEC4_READS(4, Footprints, footprints);
layout(set = 0, binding = 5, scalar) writeonly buffer InstanceTiles { uint instance_tiles[]; };
layout(set = 0, binding = 6, scalar) writeonly buffer InstanceVisible { uint instance_visible[]; };
layout(set = 0, binding = 7, scalar) writeonly buffer SlotBegins { uint slot_begins[]; };

layout(push_constant, scalar) uniform Push {
    uint extent;
    uint tiles_per_row;
    uint tile_rows;
    uint splat_stride;
};

#include "dispatch.glsl"
#include "splat_record.glsl"
#include "tile_span.glsl"

const uint RUN = SUBGROUP_SIZE * ITEMS;

// Last rank in [low, low + ranks) whose offset is at most `instance`: the lanes probe at even distances at a time.
uint find_rank(uint instance, uint low, uint ranks) {
    while (ranks > 1) {
        uint apart = (ranks + SUBGROUP_SIZE - 1) / SUBGROUP_SIZE;
        uint probe = gl_SubgroupInvocationID * apart;
        bool exists = probe < ranks;
        bool passed = exists && UINT_AT(instance_offsets, low + (exists ? probe : 0)) <= instance;
        // The first lane's has: what it searches for lies behind.
        uint last = max(subgroupBallotBitCount(subgroupBallot(passed)), 1) - 1;
        low += last * apart;
        ranks = min(apart, ranks - last * apart);
    }
    return low;
}

void main() {
    uint instances = state[STATE_INSTANCES];
    uint visible_count = state[STATE_VISIBLE];
    uint run = linear_workgroup() * (WORKGROUP_SIZE / SUBGROUP_SIZE) + gl_SubgroupID;
    uint next = run * RUN;
    uint run_begin = next;
    uint run_end = min(next + RUN, instances);
    if (next >= run_end) {
        return;
    }
    uint first_rank = find_rank(next, 0, visible_count);
    // Where a lane stopped walking over the rows of a Gaussian: it goes on from there with its next instance of it.
    uint walked_rank = NOT_VISIBLE;
    uint walked_row = 0;
    uint walked_tiles = 0;
    for (;;) {
        uint rank = first_rank + gl_SubgroupInvocationID;
        bool exists = rank < visible_count;
        uint safe_rank = exists ? rank : first_rank;
        uint offset = exists ? UINT_AT(instance_offsets, safe_rank) : 0xFFFFFFFF;
        uint visible = UINT_AT(order, safe_rank);
        vec4 mean2d = VEC4_AT(mean2d_extent, splat_at(visible, SPLAT_MEAN2D_EXTENT));
        uvec4 footprint = UVEC4_AT(footprints, splat_at(visible, SPLAT_FOOTPRINT));
        uvec2 box = extent == EXTENT_REFERENCE ? footprint.xy : pack_tiles(tile_box(mean2d, uvec2(tiles_per_row, tile_rows)));
        if (SLOTS && exists && footprint.w > 0 && offset >= run_begin && offset < run_end) {
            slot_begins[visible] = offset;
        }
        // The instances of these Gaussians, up to the end of the run.
        uint beyond = subgroupShuffle(exists ? offset + footprint.w : instances, SUBGROUP_SIZE - 1);
        uint batch_end = min(beyond, run_end);
        bool found_none = batch_end <= next;
        while (next < batch_end) {
            uint instance = min(next + gl_SubgroupInvocationID, batch_end - 1);
            // Last lane whose offset is at most `instance`.
            uint owner = 0;
            [[unroll]] for (uint bit = 64; bit > 0; bit /= 2) {
                if (bit < SUBGROUP_SIZE) {
                    uint probe = subgroupShuffle(offset, owner + bit);
                    owner += probe <= instance ? bit : 0;
                }
            }
            uint owner_visible = subgroupShuffle(visible, owner);
            uint left = instance - subgroupShuffle(offset, owner);
            vec4 owner_mean2d = vec4(subgroupShuffle(mean2d.x, owner), subgroupShuffle(mean2d.y, owner),
                subgroupShuffle(mean2d.z, owner), subgroupShuffle(mean2d.w, owner));
            uvec3 shape = uvec3(subgroupShuffle(footprint.x, owner), subgroupShuffle(footprint.y, owner),
                subgroupShuffle(footprint.z, owner));
            uvec4 tiles = unpack_tiles(uvec2(subgroupShuffle(box.x, owner), subgroupShuffle(box.y, owner)));
            bool goes_on = walked_rank == first_rank + owner;
            uint row = goes_on ? walked_row : tiles.z;
            uint before = goes_on ? walked_tiles : 0;
            uvec2 span;
            for (;;) {
                span = tile_span(row, owner_mean2d, shape, tiles.xy);
                if (left - before < span.y - span.x || row + 1 >= tiles.w) {
                    break;
                }
                before += span.y - span.x;
                row += 1;
            }
            walked_rank = first_rank + owner;
            walked_row = row;
            walked_tiles = before;
            if (next + gl_SubgroupInvocationID < batch_end) {
                instance_tiles[instance] = row * tiles_per_row + min(span.x + left - before, tiles.y - 1);
                instance_visible[instance] = owner_visible;
            }
            next += SUBGROUP_SIZE;
        }
        next = batch_end;
        if (next >= run_end) {
            break;
        }
        // Any number of Gaussians without a tile may follow each other: they are not gone through.
        first_rank = min(first_rank + SUBGROUP_SIZE, visible_count - 1);
        first_rank = find_rank(next, first_rank, found_none ? visible_count - first_rank : 1);
    }
}
