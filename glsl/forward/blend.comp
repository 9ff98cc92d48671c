// Front-to-back alpha blending of each tile's sorted Gaussians (paper, section 6; reference renderCUDA).
//
//   alpha = min(0.99, o exp(-(A dx^2 + C dy^2) / 2 - B dx dy)), skipped below 1/255;
//   C += T alpha c, T <- T (1 - alpha); a pixel stops before the Gaussian that would bring T below 1e-4.
//
// invocation: COLUMNS x ROWS pixels; subgroup: a region of the tile (tile_region.glsl): each lane tests one Gaussian's
// exact reach against the region, then all lanes blend the hits, passed round by shuffles; workgroup: one tile
// in: tile_ranges, sorted_visible, PerVisible attributes
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
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) readonly buffer TileRanges { uvec2 tile_ranges[]; };
layout(set = 0, binding = 1, scalar) readonly buffer SortedVisible { uint sorted_visible[]; };
layout(set = 0, binding = 2, scalar) readonly buffer Mean2dExtent { vec4 mean2d_extent[]; };
layout(set = 0, binding = 3, scalar) readonly buffer ConicOpacity { vec4 conic_opacity[]; };
layout(set = 0, binding = 4, scalar) readonly buffer ColorInverseDepth { vec4 color_inverse_depth[]; };
layout(set = 0, binding = 5, scalar) buffer Accumulated { vec4 accumulated[]; };
layout(set = 0, binding = 6, scalar) buffer InverseDepth { float inverse_depth[]; };
layout(set = 0, binding = 7, scalar) buffer LastEntries { uint last_entries[]; };
layout(set = 0, binding = 8, scalar) buffer State { uint state[]; };

layout(push_constant, scalar) uniform Push {
    uint image_width;
    uint image_height;
    uint tiles_per_row;
    uint tile_count;
    uint first_entry;
    uint max_entries;
    // No pass follows: a tile with more entries than this one reaches leaves the frame invalid (STATE_OVERFLOW).
    uint last_pass;
};

#include "dispatch.glsl"
#include "subgroup.glsl"
#include "tile_region.glsl"

const float LOG2_E = 1.4426950408889634;

void main() {
    uint tile = linear_workgroup();
    if (tile >= tile_count) {
        return;
    }
    uvec2 range = tile_ranges[tile];
    uint entries = range.y - range.x;
    if (gl_LocalInvocationID.x == 0 && first_entry == 0) {
        atomicMax(state[STATE_LONGEST_TILE], entries);
    }
    if (first_entry > 0 && entries <= first_entry) {
        return;
    }
    uint end = first_entry + min(entries - first_entry, max_entries);
    if (gl_LocalInvocationID.x == 0 && last_pass != 0 && end < entries) {
        state[STATE_OVERFLOW] = 1;
    }
    uvec2 origin = region_origin(uvec2(tile % tiles_per_row, tile / tiles_per_row));
    uvec2 corner = origin + lane_offset();
    vec2 corner_px = vec2(corner);

    // T < 0: the pixel has stopped, and -T is its transmittance.
    float transmittance[PIXELS];
    vec3 color[PIXELS];
    float depth[PIXELS];
    uint last[PIXELS];
    [[unroll]] for (uint k = 0; k < PIXELS; ++k) {
        uvec2 pixel = corner + pixel_step(k);
        bool inside = pixel.x < image_width && pixel.y < image_height;
        transmittance[k] = inside ? 1.0 : -1.0;
        color[k] = vec3(0.0);
        depth[k] = 0.0;
        last[k] = 0;
    }
    if (first_entry > 0) {
        [[unroll]] for (uint k = 0; k < PIXELS; ++k) {
            uvec2 pixel = corner + pixel_step(k);
            bool inside = pixel.x < image_width && pixel.y < image_height;
            uint index = inside ? pixel.y * image_width + pixel.x : 0;
            vec4 before = accumulated[index];
            color[k] = before.xyz;
            transmittance[k] = inside ? before.w : -1.0;
            last[k] = last_entries[index];
            if (INVERSE_DEPTH) {
                depth[k] = inverse_depth[index];
            }
        }
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
        vec3 form = vec3(-0.5 * LOG2_E, -LOG2_E, -0.5 * LOG2_E) * conic.xyz;
        uvec4 hits = subgroupBallot(exists && meets_region(mean2d, form, conic.w, origin));
        [[unroll]] for (uint word = 0; word < BALLOT_WORDS; ++word) {
            uint bits = hits[word];
            if (bits != 0) for (;;) {
                uint lane = findLSB(bits) + 32 * word;
                bits &= bits - 1;
                vec2 mean = vec2(subgroupShuffle(mean2d.x, lane), subgroupShuffle(mean2d.y, lane));
                float a = subgroupShuffle(form.x, lane);
                float b = subgroupShuffle(form.y, lane);
                float c = subgroupShuffle(form.z, lane);
                float opacity = subgroupShuffle(conic.w, lane);
                vec3 rgb = vec3(subgroupShuffle(shade.x, lane), subgroupShuffle(shade.y, lane),
                    subgroupShuffle(shade.z, lane));
                float inverse_z = INVERSE_DEPTH ? subgroupShuffle(shade.w, lane) : 0.0;
                vec2 d0 = mean - corner_px;
                uint place = batch + lane + 1;
                [[unroll]] for (uint k = 0; k < PIXELS; ++k) {
                    vec2 d = d0 - vec2(pixel_step(k));
                    float power = a * d.x * d.x + d.y * (c * d.y + b * d.x);
                    float alpha = min(ALPHA_MAX, opacity * exp2(power));
                    bool hit = power <= 0.0 && alpha >= ALPHA_MIN;
                    float next = transmittance[k] * (1.0 - alpha);
                    bool blends = hit && next >= TRANSMITTANCE_MIN;
                    float weight = blends ? alpha * transmittance[k] : 0.0;
                    color[k] += weight * rgb;
                    if (INVERSE_DEPTH) {
                        depth[k] += weight * inverse_z;
                    }
                    transmittance[k] = blends ? next : hit ? -abs(transmittance[k]) : transmittance[k];
                    last[k] = blends ? place : last[k];
                }
                if (bits == 0) {
                    break;
                }
            }
        }
        float brightest = transmittance[0];
        [[unroll]] for (uint k = 1; k < PIXELS; ++k) {
            brightest = max(brightest, transmittance[k]);
        }
        batch += SUBGROUP_SIZE;
        if (batch >= end || !subgroupAny(brightest > 0.0)) {
            break;
        }
    }

    // A pass that ends early keeps the sign, so that the next one knows which pixels have stopped.
    bool more = entries > end;
    [[unroll]] for (uint k = 0; k < PIXELS; ++k) {
        uvec2 pixel = corner + pixel_step(k);
        if (pixel.x < image_width && pixel.y < image_height) {
            uint index = pixel.y * image_width + pixel.x;
            accumulated[index] = vec4(color[k], more ? transmittance[k] : abs(transmittance[k]));
            last_entries[index] = last[k];
            if (INVERSE_DEPTH) {
                inverse_depth[index] = depth[k];
            }
        }
    }
}
