// Front-to-back alpha blending of each tile's sorted Gaussians (paper, section 6; reference renderCUDA).
//
//   alpha = min(0.99, o exp(-(A dx^2 + C dy^2) / 2 - B dx dy)), skipped below 1/255;
//   C += T alpha c, T <- T (1 - alpha); a pixel stops before the Gaussian that would bring T below 1e-4.
//
// invocation: COLUMNS x ROWS pixels of each of REGIONS_PER_SUBGROUP regions; subgroup: REGIONS_PER_SUBGROUP regions of the
// tile (tile_region.glsl): each lane tests one Gaussian against a region, then all lanes blend the hits, which are broadcast
// by shuffles; workgroup: one tile
// in: tile_ranges, sorted_visible, PerVisible attributes; with DEPTH_LIMIT, PerPixel: depth_limits
// out, PerPixel: accumulated (r, g, b without background, T) or, with STRIPS, composited; depth_sums, with LAST_ENTRIES
//     last_entries (1 + list index of the last blended entry of the tile, 0 if none); state[STATE_LONGEST_TILE]
// shared: see splat_shuffle.glsl; subgroup sizes 4 to 128
//
// A pass handles entries [first_entry, first_entry + max_entries) of each tile. With first_entry > 0 it continues after the
// previous pass, because drivers that limit the iterations of an invocation need several passes for very long tiles. Frames
// with very many instances take several dispatches, each over the tiles whose first instance lies in its range.
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_control_flow_attributes : require
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_vote : require
#extension GL_KHR_shader_subgroup_ballot : require
#extension GL_KHR_shader_subgroup_shuffle : require

#include "constants.glsl"
#include "buffers.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 128;
layout(constant_id = 1) const uint SUBGROUP_SIZE = 32;
layout(constant_id = 2) const bool INVERSE_DEPTH = false;
// Splats beyond depth_limits do not count.
layout(constant_id = 3) const bool DEPTH_LIMIT = false;
// With INVERSE_DEPTH: the sum of weights * z instead of weights / z.
layout(constant_id = 4) const bool LINEAR_DEPTH = false;
// See blending.glsl.
layout(constant_id = 5) const bool INCREMENTAL_EXP = false;
// Number of regions per subgroup: 1, 2 or 4. With more regions a Gaussian is fetched less often, but a lane has more pixels.
layout(constant_id = 6) const uint REGIONS_PER_SUBGROUP = 1;
// Counts the pixels under blended Gaussians, to compare the kernel's rate with the device's.
layout(constant_id = 7) const bool COUNT_HITS = false;
// See blend_io.glsl. Only for subgroups of at most 16, where a lane has four or eight rows of a column.
layout(constant_id = 8) const bool STRIPS = false;
// See region_shape.glsl.
layout(constant_id = 9) const uint REGION_HEIGHT = 8;
// See splat_shuffle.glsl.
layout(constant_id = 10) const bool BROADCAST = false;
layout(constant_id = 13) const bool SHARED_SPLATS = false;
// True if the backward pass or a report reads last_entries.
layout(constant_id = 14) const bool LAST_ENTRIES = true;
// True if splats are ordered by distance. Only forms with DEPTH_LIMIT read it: a splat behind the limit then ends no list.
layout(constant_id = 18) const bool DISTANCE_ORDER = false;
layout(local_size_x_id = 0) in;

#ifdef LENSES
#define PROJECTION PROJECTION_EQUIRECTANGULAR
#include "seam.glsl"
#endif
#include "tile_region.glsl"
#include "blending.glsl"
#include "splat_shuffle.glsl"
#include "blend_io.glsl"
#include "dispatch.glsl"
#include "subgroup.glsl"

// Maximum number of pixels of a lane in a region. A literal for the same reason as MAX_COLUMN_ROWS.
const uint MAX_PIXELS = 16;

// With COUNT_HITS: number of Gaussians blended over a region.
uint hit_count = 0;
#ifdef AUXILIARY
// Values of the lane's splat.
SplatExtra own_extra;
#endif

// Tests each lane's splat against a region and blends the hits over it. The pixels are a parameter, because llvmpipe would keep
// one array for all regions in memory, and blending would take three times as long. The result is true if one of the lane's pixels
// has not stopped.
bool blend_region(Splat own, vec4 mean2d, bool exists, uvec2 origin, uint batch, inout Pixel pixels[MAX_PIXELS]) {
    vec2 corner_px = vec2(origin + lane_offset());
    uvec4 hits = subgroupBallot(exists && meets_region(mean2d, own.form, own.opacity, origin));
    [[unroll]] for (uint word = 0; word < BALLOT_WORDS; ++word) {
        uint bits = hits[word];
        if (COUNT_HITS) hit_count += bitCount(bits);
        if (bits != 0) for (;;) {
            uint lane = findLSB(bits) + 32 * word;
            bits &= bits - 1;
            Splat splat = splat_of_lane(own, lane);
#ifdef AUXILIARY
            SplatExtra extra = HANDED_EXTRA(own_extra, lane);
#endif
            [[unroll]] for (uint column = 0; column < COLUMNS; ++column) {
                float alphas[MAX_COLUMN_ROWS];
                column_alphas(splat, corner_px + vec2(column * LANES_X, 0), alphas);
                [[unroll]] for (uint row = 0; row < ROWS; ++row) {
                    float weight = blend_splat(splat, alphas[row], batch + lane + 1, pixels[column * ROWS + row]);
#ifdef AUXILIARY
                    note_splat(
                        weight, pixels[column * ROWS + row].transmittance, splat, extra,
                        corner_px + vec2(column * LANES_X, row), batch + lane + 1, pixels[column * ROWS + row].extra);
#endif
                }
            }
            if (bits == 0) {
                break;
            }
        }
    }
    float brightest = pixels[0].transmittance;
    [[unroll]] for (uint k = 1; k < PIXELS; ++k) {
        brightest = max(brightest, pixels[k].transmittance);
    }
    return brightest > 0.0;
}

void load_region(uvec2 corner, out Pixel pixels[MAX_PIXELS]) {
    [[unroll]] for (uint k = 0; k < PIXELS; ++k) {
        pixels[k] = load_pixel(corner + pixel_step(k));
    }
}

void store_region(uvec2 corner, Pixel pixels[MAX_PIXELS], bool more) {
    [[unroll]] for (uint k = 0; k < PIXELS; ++k) {
        store_pixel(corner + pixel_step(k), pixels[k], more);
    }
    if (STRIPS && !more) {
        [[unroll]] for (uint k = 0; k + 3 < PIXELS; k += 4) {
            store_composited(
                corner + pixel_step(k), Pixel[](pixels[k], pixels[k + 1], pixels[k + 2], pixels[k + 3]));
        }
    }
}

#define DECLARE(K) \
    uvec2 origin_##K = region_origin(tile_xy, region + K); \
    Pixel pixels_##K[MAX_PIXELS];
#define LOAD(K) load_region(origin_##K + lane_offset(), pixels_##K);
#define BLEND(K) \
    if (blend_region(own, mean2d, exists && (alive >> K & 1) != 0, origin_##K, batch, pixels_##K)) lit |= 1 << K;
#define STORE(K) store_region(origin_##K + lane_offset(), pixels_##K, entries > end);

void main() {
#ifdef LENSES
    seam_period = float(whole_width);
#endif
    uint tile = tile_of(linear_workgroup());
    if (tile >= tile_count) {
        return;
    }
    uvec2 range = tile_ranges[tile];
    uint entries = range.y - range.x;
    if (!in_dispatch_range(range) || (first_entry > 0 && entries <= first_entry)) {
        return;
    }
    uint end = first_entry + min(entries - first_entry, max_entries);
    if (gl_LocalInvocationID.x == 0) {
        note_tile(entries, end);
    }
    uvec2 tile_xy = uvec2(tile % tiles_per_row, tile / tiles_per_row);
    uint region = gl_SubgroupID * REGIONS_PER_SUBGROUP;
    FOUR_REGIONS(DECLARE)
    EACH_REGION(REGIONS_PER_SUBGROUP, LOAD)

    // A bit per region with a pixel that has not stopped.
    uint alive = (1 << REGIONS_PER_SUBGROUP) - 1;
    // Both loops test at their end. With a test at the start, a driver without branches runs one more masked iteration.
    uint batch = first_entry;
    if (batch < end) for (;;) {
        uint entry = batch + gl_SubgroupInvocationID;
        bool exists = entry < end;
        uint visible = UINT_AT(sorted_visible, range.x + (exists ? entry : first_entry));
        vec4 mean2d = VEC4_AT(mean2d_extent, splat_at(visible, SPLAT_MEAN2D_EXTENT));
        vec4 conic = VEC4_AT(conic_opacity, splat_at(visible, SPLAT_CONIC_OPACITY));
        vec4 shade = VEC4_AT(color_inverse_depth, splat_at(visible, SPLAT_COLOR_INVERSE_DEPTH));
        Splat own = splat_of(mean2d.xy, conic, shade);
        share_splat(own);
#ifdef AUXILIARY
        own_extra = splat_extra(visible);
#endif
        uint lit = 0;
        EACH_REGION(REGIONS_PER_SUBGROUP, BLEND)
        // A processor's driver votes lane by lane, so the regions share a vote.
        alive = REGIONS_PER_SUBGROUP > 1 ? subgroupOr(lit) : uint(subgroupAny(lit != 0));
        batch += SUBGROUP_SIZE;
        if (batch >= end || alive == 0) {
            break;
        }
    }

    EACH_REGION(REGIONS_PER_SUBGROUP, STORE)
    if (COUNT_HITS && gl_SubgroupInvocationID == 0) {
        atomicAdd(state[STATE_BLEND_HITS], hit_count * (REGION_HEIGHT / 4));
    }
}
