// Front-to-back alpha blending of each tile's sorted Gaussians (paper, section 6; reference renderCUDA).
//
//   alpha = min(0.99, o exp(-(A dx^2 + C dy^2) / 2 - B dx dy)), skipped below 1/255;
//   C += T alpha c, T <- T (1 - alpha); a pixel stops before the Gaussian that would bring T below 1e-4.
//
// The paper's form of it: the workgroup fetches a batch of Gaussians into shared memory, and every invocation walks over
// all of them for its own pixels. Bit for bit the picture of blend.comp, which culls per region instead; which is faster
// depends on the device.
//
// invocation: PIXELS pixels, and one Gaussian of each batch to fetch; workgroup: one tile, batches of WORKGROUP_SIZE
// in: tile_ranges, sorted_visible, PerVisible attributes; with DEPTH_LIMIT, PerPixel: depth_limits
// out, PerPixel: accumulated (r, g, b without background, T), inverse_depth, last_entries (1 + place of the last
//     blended entry in its tile's list, 0 if none); state[STATE_LONGEST_TILE]
// Entries [first_entry, first_entry + max_entries) of each tile; with first_entry > 0 it goes on where the pass
// before stopped (drivers that bound the iterations of an invocation need several passes for very long tiles).
// shared: WORKGROUP_SIZE * 10 words and one; any subgroup size (no subgroup operations)
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_control_flow_attributes : require
#extension GL_GOOGLE_include_directive : require

#include "constants.glsl"

// A divisor of 256, the pixels of a tile.
layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(constant_id = 2) const bool INVERSE_DEPTH = false;
// Splats behind depth_limits do not count.
layout(constant_id = 3) const bool DEPTH_LIMIT = false;
// With INVERSE_DEPTH: the sum of weights * z in place of weights / z.
layout(constant_id = 4) const bool LINEAR_DEPTH = false;
layout(local_size_x_id = 0) in;

#include "blending.glsl"
#include "blend_io.glsl"
#include "dispatch.glsl"

const uint PIXELS = TILE_SIZE * TILE_SIZE / WORKGROUP_SIZE;
const uint ROWS_APART = WORKGROUP_SIZE / TILE_SIZE;

shared vec2 means[WORKGROUP_SIZE];
shared vec4 forms[WORKGROUP_SIZE];
shared vec4 shades[WORKGROUP_SIZE];
shared uint alive;

void main() {
    uint tile = linear_workgroup();
    bool tile_exists = tile < tile_count;
    uvec2 range = tile_exists ? tile_ranges[tile_exists ? tile : 0] : uvec2(0);
    uint entries = range.y - range.x;
    uint begin = min(first_entry, entries);
    uint end = begin + min(entries - begin, max_entries);
    bool works = tile_exists && (first_entry == 0 || entries > first_entry);
    if (gl_LocalInvocationID.x == 0 && works) {
        note_tile(entries, end);
    }
    uvec2 corner = uvec2(tile % tiles_per_row, tile / tiles_per_row) * TILE_SIZE
        + uvec2(gl_LocalInvocationID.x % TILE_SIZE, gl_LocalInvocationID.x / TILE_SIZE);
    vec2 corner_px = vec2(corner);

    Pixel pixels[PIXELS];
    [[unroll]] for (uint k = 0; k < PIXELS; ++k) {
        pixels[k] = load_pixel(corner + uvec2(0, k * ROWS_APART));
    }

    for (uint batch = begin; batch < end; batch += WORKGROUP_SIZE) {
        if (gl_LocalInvocationID.x == 0) {
            alive = 0;
        }
        barrier();
        float brightest = pixels[0].transmittance;
        [[unroll]] for (uint k = 1; k < PIXELS; ++k) {
            brightest = max(brightest, pixels[k].transmittance);
        }
        if (brightest > 0.0) {
            atomicOr(alive, 1);
        }
        uint entry = batch + gl_LocalInvocationID.x;
        uint visible = sorted_visible[range.x + (entry < end ? entry : begin)];
        vec4 conic = conic_opacity[visible];
        means[gl_LocalInvocationID.x] = mean2d_extent[visible].xy;
        forms[gl_LocalInvocationID.x] = vec4(quadratic_form(conic.xyz), conic.w);
        shades[gl_LocalInvocationID.x] = color_inverse_depth[visible];
        barrier();
        // Uniform: all have seen the same word, and nobody writes it before the barrier below.
        uint fetched = alive != 0 ? min(end - batch, WORKGROUP_SIZE) : 0;
        for (uint k = 0; k < fetched; ++k) {
            vec4 form = forms[k];
            vec4 shade = shades[k];
            Splat splat = Splat(means[k], form.xyz, form.w, shade.xyz, shade.w);
            vec2 d0 = splat.mean - corner_px;
            [[unroll]] for (uint p = 0; p < PIXELS; ++p) {
                blend_splat(splat, d0 - vec2(0, p * ROWS_APART), batch + k + 1, pixels[p]);
            }
        }
        barrier();
        if (fetched == 0) {
            break;
        }
    }

    if (works) {
        [[unroll]] for (uint k = 0; k < PIXELS; ++k) {
            store_pixel(corner + uvec2(0, k * ROWS_APART), pixels[k], entries > end);
        }
    }
}
