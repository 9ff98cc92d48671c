// Backward pass of the blending, front to back, without atomics: the gradient of each (tile, Gaussian) instance.
//
// With g = dL/dpixel, s = g . c and R = the contribution of the remaining list to g . pixel (R starts as g . final colour):
//   R <- R - T alpha s,   dL/dalpha = T s - R / (1 - alpha),   dL/dpower = alpha dL/dalpha (0 where alpha is clamped).
// An instance's sums over its pixels, with (dx, dy) = mean - pixel and p = dL/dpower:
//   sum p (1, dx, dy, dx^2, dx dy, dy^2), sum T alpha g (r, g, b, inverse depth).
// With ABSOLUTE also the sum of |dL/d(mean2d)|, x and y, with absolute values per pixel (AbsGS, Ye et al. 2024).
// With WEIGHTS only the sum of T alpha dL/dr: the Gaussian's share of a picture with the pixel weights dL/dr.
// Only the first scene has gradients, so entries behind its last one in a tile need not be blended.
// project_backward turns the moments into gradients of mean, conic and opacity. The sums are stored at the instance's index
// before the tile sort. These indices are contiguous per Gaussian, so the sum over tiles has one fixed order.
//
// invocation: COLUMNS x ROWS pixels; subgroup: a region of the tile; it culls Gaussians and broadcasts the hits as blend
// does, then adds over its lanes by a transposing butterfly; workgroup: one tile; it adds its regions in shared memory
// in: tile_ranges, sorted_visible, sorted_instances, PerVisible attributes, state[STATE_FIRST_SCENE_VISIBLE];
//     PerPixel: accumulated, depth_sums, last_entries, image_gradient (dL/d(r, g, b), dL/dinverse_depth)
// out, PerInstance: instance_gradients_a (1, dx, dy, dx dx), instance_gradients_b (dx dy, dy dy, r, g),
//     instance_gradients_c (b, inverse depth), with ABSOLUTE instance_gradients_d; with WEIGHTS only
//     instance_gradients_c (weight, 0)
// in/out, PerPixel: backward_state (T, R) between passes over very long tiles, see blend; with COUNT_HITS also
//     state[STATE_BLEND_BACKWARD_HITS]
// shared: BATCH * REGIONS * SUMS words and masks; subgroup sizes 4 to 128
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

layout(constant_id = 0) const uint WORKGROUP_SIZE = 128;
layout(constant_id = 1) const uint SUBGROUP_SIZE = 32;
layout(constant_id = 2) const bool INVERSE_DEPTH = false;
// See blending.glsl.
layout(constant_id = 3) const bool INCREMENTAL_EXP = false;
// See blend.comp.
layout(constant_id = 4) const bool COUNT_HITS = false;
// See blend_gradient.glsl. Only for subgroups of at most 16.
layout(constant_id = 5) const bool STRIPS = false;
// Select other sums, see above. At most one of the two is true.
layout(constant_id = 6) const bool ABSOLUTE = false;
layout(constant_id = 7) const bool WEIGHTS = false;
// See region_shape.glsl.
layout(constant_id = 8) const uint REGION_HEIGHT = 8;
// See splat_shuffle.glsl.
layout(constant_id = 9) const bool BROADCAST = false;
// On an H100 shared memory would take 1.02 times as long, because this kernel has enough work per splat.
const bool SHARED_SPLATS = false;
layout(local_size_x_id = 0) in;

#define OWN_REGIONS 1
#include "blend_gradient.glsl"
#include "dispatch.glsl"
#include "subgroup.glsl"

// Number of entries whose sums are added in shared memory at a time: a multiple of every subgroup size.
const uint BATCH = SUBGROUP_SIZE > 32 ? SUBGROUP_SIZE : 32;
const uint STEPS = BATCH / SUBGROUP_SIZE;
const uint MASK_WORDS = BATCH / 32;
// Number of sums per entry and region.
const uint SUMS = WEIGHTS ? 1 : ABSOLUTE ? ABSOLUTE_SUMS : INSTANCE_SUMS;

shared float partial[BATCH * REGIONS * SUMS];
shared uint touched[REGIONS * MASK_WORDS];
shared uint region_last[REGIONS];

float keep_or_give(float even, float odd, uint bit) {
    bool upper = (gl_SubgroupInvocationID & bit) != 0;
    return (upper ? odd : even) + subgroupShuffleXor(upper ? even : odd, bit);
}

float add_across(float value, uint first_bit) {
    if (first_bit <= 4 && SUBGROUP_SIZE > 4) value += subgroupShuffleXor(value, 4);
    if (SUBGROUP_SIZE > 8) value += subgroupShuffleXor(value, 8);
    if (SUBGROUP_SIZE > 16) value += subgroupShuffleXor(value, 16);
    if (SUBGROUP_SIZE > 32) value += subgroupShuffleXor(value, 32);
    if (SUBGROUP_SIZE > 64) value += subgroupShuffleXor(value, 64);
    return value;
}

// Adds ten values over the subgroup, twelve with ABSOLUTE, and stores the sums at partial[base]. Each exchange halves the
// values per lane, so ten sums cost about as many shuffles as two separate sums.
void store_sums(uint base, Sums s) {
    uint lane = gl_SubgroupInvocationID;
    if (WEIGHTS) {
        float weight = s.value.x + subgroupShuffleXor(s.value.x, 1);
        weight += subgroupShuffleXor(weight, 2);
        weight = add_across(weight, 4);
        if (lane == 0) {
            partial[base] = weight;
        }
        return;
    }
    float a = keep_or_give(keep_or_give(s.linear.x, s.linear.y, 1), keep_or_give(s.linear.z, s.quadratic.x, 1), 2);
    float b = keep_or_give(keep_or_give(s.quadratic.y, s.quadratic.z, 1), keep_or_give(s.value.x, s.value.y, 1), 2);
    float c = keep_or_give(s.value.z, s.value.w, 1);
    if (ABSOLUTE) {
        c = keep_or_give(c, keep_or_give(s.absolute.x, s.absolute.y, 1), 2);
    } else {
        c += subgroupShuffleXor(c, 2);
    }
    c = add_across(c, 4);
    if (SUBGROUP_SIZE == 4) {
        partial[base + lane] = a;
        partial[base + 4 + lane] = b;
    } else {
        float both = add_across(keep_or_give(a, b, 4), 8);
        if (lane < 8) {
            partial[base + lane] = both;
        }
    }
    if (lane < SUMS - 8) {
        partial[base + 8 + lane] = c;
    }
}

void main() {
#ifdef LENSES
    seam_period = float(whole_width);
#endif
    uint tile = tile_of(linear_workgroup());
    bool tile_exists = tile < tile_count;
    uvec2 range = tile_exists ? tile_ranges[tile_exists ? tile : 0] : uvec2(0);
    tile_exists = tile_exists && in_dispatch_range(range);
    range = tile_exists ? range : uvec2(0);
    uint entries = range.y - range.x;
    uint begin = min(first_entry, entries);
    uint end = begin + min(entries - begin, max_entries);
    uvec2 origin = region_origin(uvec2(tile % tiles_per_row, tile / tiles_per_row), gl_SubgroupID);
    uvec2 corner = origin + lane_offset();
    vec2 corner_px = vec2(corner);

    uint lane_last = load_pixels(corner, tile_exists, 0);
    uint own_last = subgroupMax(lane_last);
    if (gl_SubgroupInvocationID == 0) {
        region_last[gl_SubgroupID] = own_last;
    }
    barrier();
    uint tile_last = 0;
    [[unroll]] for (uint region = 0; region < REGIONS; ++region) {
        tile_last = max(tile_last, region_last[region]);
    }
    uint work_end = blended_end(range, begin, end, tile_last);

    for (uint batch = begin; batch < work_end; batch += BATCH) {
        for (uint step = 0; step < STEPS; ++step) {
            uint entry = batch + step * SUBGROUP_SIZE + gl_SubgroupInvocationID;
            bool exists = entry < end && entry < own_last;
            uint visible = UINT_AT(sorted_visible, range.x + (exists ? entry : begin));
            vec4 mean2d = VEC4_AT(mean2d_extent, splat_at(visible, SPLAT_MEAN2D_EXTENT));
            vec4 conic = VEC4_AT(conic_opacity, splat_at(visible, SPLAT_CONIC_OPACITY));
            vec4 shade = VEC4_AT(color_inverse_depth, splat_at(visible, SPLAT_COLOR_INVERSE_DEPTH));
            Splat own = splat_of(mean2d.xy, conic, shade);
            uvec4 hits = subgroupBallot(exists && meets_region(mean2d, own.form, own.opacity, origin));
            [[unroll]] for (uint word = 0; word < BALLOT_WORDS; ++word) {
                uint bits = hits[word];
                if (COUNT_HITS) hit_count += bitCount(bits);
                if (gl_SubgroupInvocationID == 0) {
                    uint mask_word = gl_SubgroupID * MASK_WORDS + step * SUBGROUP_SIZE / 32 + word;
                    uint shift = step * SUBGROUP_SIZE % 32;
                    touched[mask_word] = shift == 0 ? bits : touched[mask_word] | bits << shift;
                }
                // The loop tests at its end: see blend.comp.
                if (bits != 0) for (;;) {
                    uint lane = findLSB(bits) + 32 * word;
                    bits &= bits - 1;
                    Splat splat = splat_of_lane(own, lane);
                    uint place = batch + step * SUBGROUP_SIZE + lane + 1;
                    Sums sums = blend_backward(splat, place, corner_px, 0);
                    uint base = ((step * SUBGROUP_SIZE + lane) * REGIONS + gl_SubgroupID) * SUMS;
                    store_sums(base, sums);
                    if (bits == 0) {
                        break;
                    }
                }
            }
        }
        barrier();
        [[unroll]] for (uint round = 0; round < BATCH; round += WORKGROUP_SIZE) {
            uint member = round + gl_LocalInvocationID.x;
            uint entry = batch + member;
            if (member < BATCH && entry < end) {
                float sums[ABSOLUTE_SUMS];
                [[unroll]] for (uint k = 0; k < ABSOLUTE_SUMS; ++k) {
                    sums[k] = 0.0;
                }
                [[unroll]] for (uint region = 0; region < REGIONS; ++region) {
                    bool hit = (touched[region * MASK_WORDS + member / 32] >> (member % 32) & 1) != 0;
                    uint base = (member * REGIONS + region) * SUMS;
                    [[unroll]] for (uint k = 0; k < SUMS; ++k) {
                        float value = partial[base + k];
                        sums[k] += hit ? value : 0.0;
                    }
                }
                vec4 value = WEIGHTS ? vec4(sums[0]) : vec4(sums[6], sums[7], sums[8], sums[9]);
                store_instance(range.x + entry, Sums(vec3(sums[0], sums[1], sums[2]), vec3(sums[3], sums[4], sums[5]),
                    value, vec2(sums[10], sums[11])));
            }
        }
        barrier();
    }

    // The rest of the list has zero gradients: no pixel blended it, or it comes after the first scene's last entry.
    // project_backward reads the first scene's gradients, so they must be written.
    uint batches = (work_end - begin + BATCH - 1) / BATCH;
    for (uint entry = begin + batches * BATCH + gl_LocalInvocationID.x; entry < end; entry += WORKGROUP_SIZE) {
        store_instance(range.x + entry, no_sums());
    }

    if (entries > end) {
        store_pixels(corner, tile_exists, 0);
    }
    note_hits();
}
