// Same as blend_backward.comp, without shared memory and barriers. For processors, where a barrier moves every variable of a
// loop to memory, and shared memory is accessed lane by lane.
//
// invocation: COLUMNS x ROWS pixels of each region of the tile; subgroup and workgroup: one tile. Each lane fetches one
// Gaussian, tests it against each region, and broadcasts it; the sums over all lanes and regions end up in the registers
// of the lane that fetched the Gaussian
// in, out: same as blend_backward.comp
// shared: none; subgroup sizes 4 to 128
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_control_flow_attributes : require
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#extension GL_KHR_shader_subgroup_ballot : require
#extension GL_KHR_shader_subgroup_shuffle : require

#include "constants.glsl"
#include "buffers.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 32;
layout(constant_id = 1) const uint SUBGROUP_SIZE = 32;
layout(constant_id = 2) const bool INVERSE_DEPTH = false;
// See blending.glsl.
layout(constant_id = 3) const bool INCREMENTAL_EXP = false;
// See blend.comp.
layout(constant_id = 4) const bool COUNT_HITS = false;
// See blend_gradient.glsl. Only for subgroups of at most 16.
layout(constant_id = 5) const bool STRIPS = false;
// See blend_backward.comp.
layout(constant_id = 6) const bool ABSOLUTE = false;
layout(constant_id = 7) const bool WEIGHTS = false;
layout(local_size_x_id = 0) in;

const uint REGION_HEIGHT = SUBGROUP_SIZE <= 64 ? 8 : 16;
const bool BROADCAST = false;
const bool SHARED_SPLATS = false;

#define OWN_REGIONS 4
#include "blend_gradient.glsl"
#include "dispatch.glsl"
#include "subgroup.glsl"

// Sum over the subgroup, in all lanes. Uses shuffles, because subgroupAdd is slow on drivers without vector instructions for
// it.
float add_over_lanes(float value) {
    value += subgroupShuffleXor(value, 1);
    value += subgroupShuffleXor(value, 2);
    if (SUBGROUP_SIZE > 4) value += subgroupShuffleXor(value, 4);
    if (SUBGROUP_SIZE > 8) value += subgroupShuffleXor(value, 8);
    if (SUBGROUP_SIZE > 16) value += subgroupShuffleXor(value, 16);
    if (SUBGROUP_SIZE > 32) value += subgroupShuffleXor(value, 32);
    if (SUBGROUP_SIZE > 64) value += subgroupShuffleXor(value, 64);
    return value;
}

void add_if(bool own, inout float sum, float value) {
    float total = add_over_lanes(value);
    sum += own ? total : 0.0;
}

// Tests each lane's Gaussian against a region, and blends the hits.
void blend_region(Splat own, vec4 mean2d, bool exists, uvec2 origin, uint batch, uint first,
    inout Sums own_sums) {
    vec2 corner_px = vec2(origin + lane_offset());
    uvec4 hits = subgroupBallot(exists && meets_region(mean2d, own.form, own.opacity, origin));
    [[unroll]] for (uint word = 0; word < BALLOT_WORDS; ++word) {
        uint bits = hits[word];
        if (COUNT_HITS) hit_count += bitCount(bits);
        // The loop tests at its end: see blend.comp.
        if (bits != 0) for (;;) {
            uint lane = findLSB(bits) + 32 * word;
            bits &= bits - 1;
            Splat splat = splat_of_lane(own, lane);
            Sums sums = blend_backward(splat, batch + lane + 1, corner_px, first);
            bool mine = gl_SubgroupInvocationID == lane;
            add_if(mine, own_sums.value.x, sums.value.x);
            if (!WEIGHTS) {
                add_if(mine, own_sums.linear.x, sums.linear.x);
                add_if(mine, own_sums.linear.y, sums.linear.y);
                add_if(mine, own_sums.linear.z, sums.linear.z);
                add_if(mine, own_sums.quadratic.x, sums.quadratic.x);
                add_if(mine, own_sums.quadratic.y, sums.quadratic.y);
                add_if(mine, own_sums.quadratic.z, sums.quadratic.z);
                add_if(mine, own_sums.value.y, sums.value.y);
                add_if(mine, own_sums.value.z, sums.value.z);
            }
            if (INVERSE_DEPTH) add_if(mine, own_sums.value.w, sums.value.w);
            if (ABSOLUTE) {
                add_if(mine, own_sums.absolute.x, sums.absolute.x);
                add_if(mine, own_sums.absolute.y, sums.absolute.y);
            }
            if (bits == 0) {
                break;
            }
        }
    }
}

#define DECLARE(K) \
    uvec2 origin_##K = region_origin(tile_xy, K); \
    uint last_##K = 0;
#define LOAD(K) last_##K = subgroupMax(load_pixels(origin_##K + lane_offset(), true, K * PIXELS));
#define BLEND(K) blend_region(own, mean2d, exists && entry < last_##K, origin_##K, batch, K * PIXELS, sums);
#define STORE(K) store_pixels(origin_##K + lane_offset(), true, K * PIXELS);

void main() {
#ifdef LENSES
    seam_period = float(whole_width);
#endif
    uint tile = tile_of(linear_workgroup());
    if (tile >= tile_count) {
        return;
    }
    uvec2 range = tile_ranges[tile];
    if (!in_dispatch_range(range)) {
        return;
    }
    uint entries = range.y - range.x;
    uint begin = min(first_entry, entries);
    uint end = begin + min(entries - begin, max_entries);
    uvec2 tile_xy = uvec2(tile % tiles_per_row, tile / tiles_per_row);
    FOUR_REGIONS(DECLARE)
    EACH_REGION(REGIONS, LOAD)
    uint tile_last = max(max(last_0, last_1), max(last_2, last_3));
    uint work_end = blended_end(range, begin, end, tile_last);

    uint batch = begin;
    if (batch < work_end) for (;;) {
        uint entry = batch + gl_SubgroupInvocationID;
        bool exists = entry < end;
        uint visible = UINT_AT(sorted_visible, range.x + (exists ? entry : begin));
        vec4 mean2d = VEC4_AT(mean2d_extent, splat_at(visible, SPLAT_MEAN2D_EXTENT));
        vec4 conic = VEC4_AT(conic_opacity, splat_at(visible, SPLAT_CONIC_OPACITY));
        vec4 shade = VEC4_AT(color_inverse_depth, splat_at(visible, SPLAT_COLOR_INVERSE_DEPTH));
        Splat own = splat_of(mean2d.xy, conic, shade);
        Sums sums = no_sums();
        EACH_REGION(REGIONS, BLEND)
        if (exists) {
            store_instance(range.x + entry, sums);
        }
        batch += SUBGROUP_SIZE;
        if (batch >= work_end) {
            break;
        }
    }

    // See blend_backward.comp.
    for (uint entry = batch + gl_SubgroupInvocationID; entry < end; entry += SUBGROUP_SIZE) {
        store_instance(range.x + entry, no_sums());
    }

    if (entries > end) {
        EACH_REGION(REGIONS, STORE)
    }
    note_hits();
}
