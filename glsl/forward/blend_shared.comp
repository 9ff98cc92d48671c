// Front-to-back alpha blending of each tile's sorted Gaussians (paper, section 6; reference renderCUDA).
//
//   alpha = min(0.99, o exp(-(A dx^2 + C dy^2) / 2 - B dx dy)), skipped below 1/255;
//   C += T alpha c, T <- T (1 - alpha); a pixel stops before the Gaussian that would bring T below 1e-4.
//
// The paper's form of the kernel. The workgroup fetches a batch of Gaussians into shared memory, and every invocation loops
// over the whole batch for its own pixels. The picture equals that of blend.comp, which culls per region instead. They agree to
// the bit if the compiler fuses sums of products in both kernels or in neither. The device decides which kernel is faster.
//
// invocation: PIXELS pixels, and one Gaussian of each batch to fetch; workgroup: one tile, batches of WORKGROUP_SIZE
// in: tile_ranges, sorted_visible, PerVisible attributes; with DEPTH_LIMIT, PerPixel: depth_limits
// out, PerPixel: accumulated (r, g, b without background, T) or, with STRIPS, composited; depth_sums, with LAST_ENTRIES
//     last_entries (1 + list index of the last blended entry of the tile, 0 if none); state[STATE_LONGEST_TILE]
// shared: WORKGROUP_SIZE * 10 words and one; any subgroup size (no subgroup operations)
//
// With INCREMENTAL_EXP a pixel's value depends on its position in a column, so the columns are those of blend.comp.
// A pass handles entries [first_entry, first_entry + max_entries) of each tile. With first_entry > 0 it continues after the
// previous pass, because drivers that limit the iterations of an invocation need several passes for very long tiles.
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_control_flow_attributes : require
#extension GL_GOOGLE_include_directive : require

#include "constants.glsl"
#include "buffers.glsl"

// A divisor of 256 / COLUMN_ROWS, the number of columns of a tile.
layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(constant_id = 1) const uint SUBGROUP_SIZE = 32;
layout(constant_id = 2) const bool INVERSE_DEPTH = false;
// Splats beyond depth_limits do not count.
layout(constant_id = 3) const bool DEPTH_LIMIT = false;
// With INVERSE_DEPTH: the sum of weights * z instead of weights / z.
layout(constant_id = 4) const bool LINEAR_DEPTH = false;
// See blending.glsl.
layout(constant_id = 5) const bool INCREMENTAL_EXP = false;
// Counts the pixels under blended Gaussians, like blend.comp.
layout(constant_id = 7) const bool COUNT_HITS = false;
// See blend_io.glsl. Only with INCREMENTAL_EXP.
layout(constant_id = 8) const bool STRIPS = false;
// See blend.comp.
layout(constant_id = 14) const bool LAST_ENTRIES = true;
// True if splats are ordered by distance. Only forms with DEPTH_LIMIT read it: a splat behind the limit then ends no list.
layout(constant_id = 18) const bool DISTANCE_ORDER = false;
layout(local_size_x_id = 0) in;

const uint REGION_HEIGHT = SUBGROUP_SIZE <= 64 ? 8 : 16;

#include "region_shape.glsl"

const uint COLUMN_ROWS = INCREMENTAL_EXP ? ROWS : 1;
// Number of columns and pixels per invocation.
const uint OWN_COLUMNS = TILE_SIZE * TILE_SIZE / COLUMN_ROWS / WORKGROUP_SIZE;
const uint PIXELS = OWN_COLUMNS * COLUMN_ROWS;

#ifdef LENSES
#define PROJECTION PROJECTION_EQUIRECTANGULAR
#include "seam.glsl"
#endif
#include "blending.glsl"
#include "blend_io.glsl"
#include "dispatch.glsl"

shared vec2 means[WORKGROUP_SIZE];
shared vec4 conics[WORKGROUP_SIZE];
shared vec4 shades[WORKGROUP_SIZE];
#ifdef AUXILIARY
shared SplatExtra extras[HAS_SPLAT_EXTRA ? WORKGROUP_SIZE : 1];
#endif
shared uint alive;

// First pixel, within the tile, of column k of the invocation. Columns are numbered from left to right, then from top to
// bottom.
uvec2 column_origin(uint k) {
    uint column = gl_LocalInvocationID.x + k * WORKGROUP_SIZE;
    return uvec2(column % TILE_SIZE, column / TILE_SIZE * COLUMN_ROWS);
}

uvec2 pixel_of(uint k) {
    return column_origin(k / COLUMN_ROWS) + uvec2(0, k % COLUMN_ROWS);
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
    bool works = tile_exists && (first_entry == 0 || entries > first_entry);
    if (gl_LocalInvocationID.x == 0 && works) {
        note_tile(entries, end);
    }
    uvec2 corner = uvec2(tile % tiles_per_row, tile / tiles_per_row) * TILE_SIZE;

    Pixel pixels[PIXELS];
    [[unroll]] for (uint k = 0; k < PIXELS; ++k) {
        pixels[k] = load_pixel(corner + pixel_of(k));
    }

    // With COUNT_HITS: number of Gaussians that all pixels of the tile loop over.
    uint walked = 0;
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
        uint visible = UINT_AT(sorted_visible, range.x + (entry < end ? entry : begin));
        means[gl_LocalInvocationID.x] = VEC4_AT(mean2d_extent, splat_at(visible, SPLAT_MEAN2D_EXTENT)).xy;
        conics[gl_LocalInvocationID.x] = VEC4_AT(conic_opacity, splat_at(visible, SPLAT_CONIC_OPACITY));
        shades[gl_LocalInvocationID.x] = VEC4_AT(color_inverse_depth, splat_at(visible, SPLAT_COLOR_INVERSE_DEPTH));
#ifdef AUXILIARY
        if (HAS_SPLAT_EXTRA) {
            extras[gl_LocalInvocationID.x] = splat_extra(visible);
        }
#endif
        barrier();
        // Uniform: all invocations have read the same word, and no invocation writes it before the barrier below.
        uint fetched = alive != 0 ? min(end - batch, WORKGROUP_SIZE) : 0;
        for (uint k = 0; k < fetched; ++k) {
            Splat splat = splat_of(means[k], conics[k], shades[k]);
#ifdef AUXILIARY
            SplatExtra extra = extras[HAS_SPLAT_EXTRA ? k : 0];
#endif
            [[unroll]] for (uint column = 0; column < OWN_COLUMNS; ++column) {
                float alphas[MAX_COLUMN_ROWS];
                column_alphas(splat, vec2(corner + column_origin(column)), alphas);
                [[unroll]] for (uint row = 0; row < COLUMN_ROWS; ++row) {
                    float weight =
                        blend_splat(splat, alphas[row], batch + k + 1, pixels[column * COLUMN_ROWS + row]);
#ifdef AUXILIARY
                    note_splat(
                        weight, pixels[column * COLUMN_ROWS + row].transmittance, splat, extra,
                        vec2(corner + column_origin(column) + uvec2(0, row)), batch + k + 1,
                        pixels[column * COLUMN_ROWS + row].extra);
#endif
                }
            }
        }
        if (COUNT_HITS) walked += fetched;
        barrier();
        if (fetched == 0) {
            break;
        }
    }

    if (works) {
        [[unroll]] for (uint k = 0; k < PIXELS; ++k) {
            store_pixel(corner + pixel_of(k), pixels[k], entries > end);
        }
        if (STRIPS && entries <= end) {
            [[unroll]] for (uint k = 0; k + 3 < PIXELS; k += 4) {
                store_composited(corner + pixel_of(k), Pixel[](pixels[k], pixels[k + 1], pixels[k + 2], pixels[k + 3]));
            }
        }
        if (COUNT_HITS && gl_LocalInvocationID.x == 0) {
            atomicAdd(state[STATE_BLEND_HITS], walked * (TILE_SIZE * TILE_SIZE / 32));
        }
    }
}
