// Front-to-back alpha blending of each tile's sorted Gaussians (paper, section 6; reference renderCUDA).
//
//   alpha = min(0.99, o exp(-(A dx^2 + C dy^2) / 2 - B dx dy)), skipped below 1/255;
//   C += T alpha c, T <- T (1 - alpha); a pixel stops before the Gaussian that would bring T below 1e-4.
//
// invocation: COLUMNS x ROWS pixels; subgroup: a region of the tile (tile_region.glsl): each lane tests one Gaussian's
// exact reach against the region, then all lanes blend the hits, passed round by shuffles; workgroup: one tile
// in: tile_ranges, sorted_visible, PerVisible attributes; with DEPTH_LIMIT, PerPixel: depth_limits
// out, PerPixel: accumulated (r, g, b without background, T), inverse_depth, last_entries (1 + place of the last
//     blended entry in its tile's list, 0 if none); state[STATE_LONGEST_TILE]
// Entries [first_entry, first_entry + max_entries) of each tile; with first_entry > 0 it goes on where the pass
// before stopped (drivers that bound the iterations of an invocation need several passes for very long tiles).
// shared: none; subgroup sizes 4 to 128
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_control_flow_attributes : require
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_vote : require
#extension GL_KHR_shader_subgroup_ballot : require
#extension GL_KHR_shader_subgroup_shuffle : require

#include "constants.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 128;
layout(constant_id = 1) const uint SUBGROUP_SIZE = 32;
layout(constant_id = 2) const bool INVERSE_DEPTH = false;
// Splats behind depth_limits do not count.
layout(constant_id = 3) const bool DEPTH_LIMIT = false;
// With INVERSE_DEPTH: the sum of weights * z in place of weights / z.
layout(constant_id = 4) const bool LINEAR_DEPTH = false;
layout(local_size_x_id = 0) in;

#include "blending.glsl"
#include "blend_io.glsl"
#include "dispatch.glsl"
#include "subgroup.glsl"
#include "tile_region.glsl"

Splat shuffled(Splat splat, uint lane) {
    return Splat(
        vec2(subgroupShuffle(splat.mean.x, lane), subgroupShuffle(splat.mean.y, lane)),
        vec3(subgroupShuffle(splat.form.x, lane), subgroupShuffle(splat.form.y, lane), subgroupShuffle(splat.form.z, lane)),
        subgroupShuffle(splat.opacity, lane),
        vec3(subgroupShuffle(splat.rgb.x, lane), subgroupShuffle(splat.rgb.y, lane), subgroupShuffle(splat.rgb.z, lane)),
        INVERSE_DEPTH || DEPTH_LIMIT ? subgroupShuffle(splat.inverse_z, lane) : 0.0);
}

void main() {
    uint tile = linear_workgroup();
    if (tile >= tile_count) {
        return;
    }
    uvec2 range = tile_ranges[tile];
    uint entries = range.y - range.x;
    if (first_entry > 0 && entries <= first_entry) {
        return;
    }
    uint end = first_entry + min(entries - first_entry, max_entries);
    if (gl_LocalInvocationID.x == 0) {
        note_tile(entries, end);
    }
    uvec2 origin = region_origin(uvec2(tile % tiles_per_row, tile / tiles_per_row));
    uvec2 corner = origin + lane_offset();
    vec2 corner_px = vec2(corner);

    Pixel pixels[PIXELS];
    [[unroll]] for (uint k = 0; k < PIXELS; ++k) {
        pixels[k] = load_pixel(corner + pixel_step(k));
    }

    // Both loops test at their end: a loop that tests first costs a driver without branches one more masked iteration.
    uint batch = first_entry;
    if (batch < end) for (;;) {
        uint entry = batch + gl_SubgroupInvocationID;
        bool exists = entry < end;
        uint visible = sorted_visible[range.x + (exists ? entry : first_entry)];
        vec4 mean2d = mean2d_extent[visible];
        vec4 conic = conic_opacity[visible];
        vec4 shade = color_inverse_depth[visible];
        Splat own = Splat(mean2d.xy, quadratic_form(conic.xyz), conic.w, shade.xyz, shade.w);
        uvec4 hits = subgroupBallot(exists && meets_region(mean2d, own.form, own.opacity, origin));
        [[unroll]] for (uint word = 0; word < BALLOT_WORDS; ++word) {
            uint bits = hits[word];
            if (bits != 0) for (;;) {
                uint lane = findLSB(bits) + 32 * word;
                bits &= bits - 1;
                Splat splat = shuffled(own, lane);
                vec2 d0 = splat.mean - corner_px;
                [[unroll]] for (uint k = 0; k < PIXELS; ++k) {
                    blend_splat(splat, d0 - vec2(pixel_step(k)), batch + lane + 1, pixels[k]);
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
        batch += SUBGROUP_SIZE;
        if (batch >= end || !subgroupAny(brightest > 0.0)) {
            break;
        }
    }

    [[unroll]] for (uint k = 0; k < PIXELS; ++k) {
        store_pixel(corner + pixel_step(k), pixels[k], entries > end);
    }
}
