// One (tile, Gaussian) instance per touched tile, in depth order and, within a Gaussian, row by row (paper, section 6;
// reference duplicateWithKeys).
//
// Work is split by instances, so a Gaussian that covers the screen costs no more per invocation than a small one. A subgroup
// searches for the Gaussian of its first instance, then advances through the ranks. Each lane fetches one Gaussian. The
// instances of these Gaussians are distributed over the lanes, and a lane reads its Gaussian's list of tiles by shuffles.
// Gaussians with too many tiles for a list come last. The subgroup handles them one by one: each lane computes the span of
// one row, and the tiles of these rows are distributed in the same way.
//
// invocation: ITEMS instances; subgroup: a run of SUBGROUP_SIZE * ITEMS consecutive instances
// in: order[rank], block_instances[rank] and block_offsets[rank / SCAN_BLOCK] (their sum: a Gaussian's first instance),
//     list_heads[rank], list_rows[rank] (tile_list.glsl); for Gaussians without a list, PerVisible: mean2d_extent, footprints
// out: instance_tiles[instance] (sort keys), instance_visible[instance]; with FOR_BACKWARD first_instances[visible] = its
//      first instance
// shared: none; subgroup sizes 4 to 128
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_control_flow_attributes : require
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#extension GL_KHR_shader_subgroup_ballot : require
#extension GL_KHR_shader_subgroup_shuffle : require
#extension GL_KHR_shader_subgroup_vote : require

#include "constants.glsl"
#include "buffers.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(constant_id = 1) const uint SUBGROUP_SIZE = 32;
layout(constant_id = 2) const uint ITEMS = 16;
layout(constant_id = 3) const bool FOR_BACKWARD = true;
layout(constant_id = 4) const uint SCAN_BLOCK = 1024;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) readonly buffer State { uint state[]; };
UINT_READS(1, Order, order);
UINT_READS(2, BlockInstances, block_instances);
UINT_READS(3, BlockOffsets, block_offsets);
VEC4_READS(4, Mean2dExtent, mean2d_extent);
UVEC4_READS(5, Footprints, footprints);
UINT_READS(6, ListHeads, list_heads);
UINT_READS(7, ListRows, list_rows);
layout(set = 0, binding = 8, scalar) writeonly buffer InstanceTiles { uint instance_tiles[]; };
layout(set = 0, binding = 9, scalar) writeonly buffer InstanceVisible { uint instance_visible[]; };
layout(set = 0, binding = 10, scalar) writeonly buffer FirstInstances { uint first_instances[]; };

layout(push_constant, scalar) uniform Push {
    uint extent;
    uint tiles_per_row;
    uint tile_rows;
    uint splat_stride;
#ifdef LENSES
    // Panoramas: see seam.glsl.
    uint image_width;
    uint whole_width;
#endif
};

#ifdef LENSES
#define PROJECTION PROJECTION_EQUIRECTANGULAR
#endif

#include "dispatch.glsl"
#include "splat_record.glsl"
#include "tile_span.glsl"

const uint RUN = SUBGROUP_SIZE * ITEMS;

uint first_instance(uint rank) {
    return UINT_AT(block_instances, rank) + UINT_AT(block_offsets, rank / SCAN_BLOCK);
}

// Last rank in [low, low + ranks) whose first instance is at most `instance`. The lanes probe at equal distances in each round.
uint find_rank(uint instance, uint low, uint ranks) {
    while (ranks > 1) {
        uint apart = (ranks + SUBGROUP_SIZE - 1) / SUBGROUP_SIZE;
        uint probe = gl_SubgroupInvocationID * apart;
        bool exists = probe < ranks;
        bool passed = exists && first_instance(low + (exists ? probe : 0)) <= instance;
        // The first lane's probe always passes, because the searched rank is at or after it.
        uint last = max(subgroupBallotBitCount(subgroupBallot(passed)), 1) - 1;
        low += last * apart;
        ranks = min(apart, ranks - last * apart);
    }
    return low;
}

// Last lane with `begin` <= `instance`. The first lane satisfies this.
uint owner_of(uint instance, uint begin) {
    uint owner = 0;
    [[unroll]] for (uint bit = 64; bit > 0; bit /= 2) {
        if (bit < SUBGROUP_SIZE) {
            uint probe = subgroupShuffle(begin, owner + bit);
            owner += probe <= instance ? bit : 0;
        }
    }
    return owner;
}

// Writes the instances in [run_begin, run_end) of Gaussians without a list, from rank `rank` on.
void put_unlisted(uint rank, uint visible_count, uint run_begin, uint run_end) {
    bool done = false;
    do {
        uint own_rank = rank + gl_SubgroupInvocationID;
        bool exists = own_rank < visible_count;
        uint safe_rank = exists ? own_rank : 0;
        uint offset = first_instance(safe_rank);
        uint head = UINT_AT(list_heads, safe_rank);
        uint tiles = exists ? tiles_met(uvec2(head, 0)) : 0;
        bool ends = !exists || offset >= run_end;
        bool many = !ends && !is_listed(uvec2(head, 0)) && tiles > 0 && offset + tiles > run_begin;
        uvec4 found = subgroupBallot(many);
        bool one = subgroupAny(many);
        uint owner = one ? subgroupBallotFindLSB(found) : 0;

        uint visible = UINT_AT(order, one ? rank + owner : 0);
        vec4 mean2d = VEC4_AT(mean2d_extent, splat_at(visible, SPLAT_MEAN2D_EXTENT));
        uvec3 shape = UVEC4_AT(footprints, splat_at(visible, SPLAT_FOOTPRINT)).xyz;
        uvec4 box = extent == EXTENT_REFERENCE ? unpack_tiles(shape.xy) : tile_box(mean2d, uvec2(tiles_per_row, tile_rows));
        uint rows_begin = subgroupShuffle(offset, owner);
        uint next = max(rows_begin, run_begin);
        uint stop = one ? min(rows_begin + subgroupShuffle(tiles, owner), run_end) : 0;
        uint first_row = box.z;
        do {
            uint row = first_row + gl_SubgroupInvocationID;
            uvec2 span = tile_span(row, mean2d, shape, box.xy);
            uint width = row < box.w ? span.y - span.x : 0;
            uint row_end = rows_begin + subgroupInclusiveAdd(width);
            uint row_begin = row_end - width;
            rows_begin = subgroupShuffle(row_end, SUBGROUP_SIZE - 1);
            // The box's last row takes all remaining instances, so each has a tile even if the count was rounded differently.
            uint last_lane = box.w - 1 - first_row;
            uint rows_end = last_lane < SUBGROUP_SIZE ? stop : min(rows_begin, stop);
            do {
                uint instance = next + gl_SubgroupInvocationID;
                uint from = min(owner_of(instance, row_begin), last_lane);
                uint column = subgroupShuffle(span.x, from) + instance - subgroupShuffle(row_begin, from);
                column = min(column, box.y - 1);
#ifdef LENSES
                column %= tiles_per_row;
#endif
                if (instance < rows_end) {
                    instance_tiles[instance] = (first_row + from) * tiles_per_row + column;
                    instance_visible[instance] = visible;
                }
                next = max(next, min(next + SUBGROUP_SIZE, rows_end));
            } while (next < rows_end);
            first_row += SUBGROUP_SIZE;
        } while (next < stop && first_row < box.w);
        done = !one && subgroupAny(ends);
        rank += one ? owner + 1 : SUBGROUP_SIZE;
        // Any number of Gaussians without a tile may follow each other. A search skips them.
        bool skips = !done && !subgroupAny(tiles > 0) && rank < visible_count;
        rank = find_rank(subgroupShuffle(offset, 0), rank, skips ? visible_count - rank : 1);
    } while (!done);
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
    uint run_rank = first_rank;
    bool any_unlisted = false;
    for (;;) {
        uint rank = first_rank + gl_SubgroupInvocationID;
        bool exists = rank < visible_count;
        uint safe_rank = exists ? rank : first_rank;
        uint offset = exists ? first_instance(safe_rank) : 0xFFFFFFFF;
        uint visible = UINT_AT(order, safe_rank);
        uvec2 list = uvec2(UINT_AT(list_heads, safe_rank), UINT_AT(list_rows, safe_rank));
        uint tiles = exists ? tiles_met(list) : 0;
        if (FOR_BACKWARD && tiles > 0 && offset >= run_begin && offset < run_end) {
            first_instances[visible] = offset;
        }
        any_unlisted = any_unlisted || tiles > 0 && !is_listed(list);
        // The end of these Gaussians' instances, at most the end of the run.
        uint beyond = subgroupShuffle(exists ? offset + tiles : instances, SUBGROUP_SIZE - 1);
        uint batch_end = min(beyond, run_end);
        bool found_none = batch_end <= next;
        while (next < batch_end) {
            uint instance = min(next + gl_SubgroupInvocationID, batch_end - 1);
            uint owner = owner_of(instance, offset);
            uvec2 owner_list = uvec2(subgroupShuffle(list.x, owner), subgroupShuffle(list.y, owner));
            uint left = instance - subgroupShuffle(offset, owner);
            uint owner_visible = subgroupShuffle(visible, owner);
            if (next + gl_SubgroupInvocationID < batch_end && is_listed(owner_list)) {
                instance_tiles[instance] = listed_tile(owner_list, left, tiles_per_row);
                instance_visible[instance] = owner_visible;
            }
            next += SUBGROUP_SIZE;
        }
        next = batch_end;
        if (next >= run_end) {
            break;
        }
        // Same as in put_unlisted.
        first_rank = min(first_rank + SUBGROUP_SIZE, visible_count - 1);
        first_rank = find_rank(next, first_rank, found_none ? visible_count - first_rank : 1);
    }
    if (subgroupAny(any_unlisted)) {
        put_unlisted(run_rank, visible_count, run_begin, run_end);
    }
}
