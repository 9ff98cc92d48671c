// Buffers and push constants of the blending kernels, and the state of a pixel between passes.
//
// With STRIPS the picture is composited on the background and stored as three planes in strips (strips.glsl). The loss and the
// backward pass use that layout on processors. `accumulated` then carries the state from one pass to the next, and with
// INVERSE_DEPTH the transmittance for depth losses.
//
// Needs blending.glsl, buffers.glsl, STRIPS, LAST_ENTRIES.

layout(set = 0, binding = 0, scalar) readonly buffer TileRanges { uvec2 tile_ranges[]; };
UINT_READS(1, SortedVisible, sorted_visible);
VEC4_READS(2, Mean2dExtent, mean2d_extent);
VEC4_READS(3, ConicOpacity, conic_opacity);
VEC4_READS(4, ColorInverseDepth, color_inverse_depth);
layout(set = 0, binding = 5, scalar) buffer Accumulated { vec4 accumulated[]; };
layout(set = 0, binding = 6, scalar) buffer DepthSums { float depth_sums[]; };
layout(set = 0, binding = 7, scalar) buffer LastEntries { uint last_entries[]; };
layout(set = 0, binding = 8, scalar) buffer State { uint state[]; };
// Per pixel: 1/z of the host's nearest opaque surface, 0 without one. Only read with DEPTH_LIMIT.
layout(set = 0, binding = 9, scalar) readonly buffer DepthLimits { float depth_limits[]; };

VEC4_WRITES(10, Composited, composited);

layout(push_constant, scalar) uniform Push {
    uint image_width;
    uint image_height;
    uint tiles_per_row;
    uint tile_count;
    // This pass handles entries [first_entry, first_entry + max_entries) of each tile.
    uint first_entry;
    uint max_entries;
    // This dispatch handles the tiles whose first instance lies in [first_instance, first_instance + max_instances).
    uint first_instance;
    uint max_instances;
    // See tile_order.glsl.
    uint tile_row_interleave;
    // 1 in the last pass: a tile with entries beyond this pass then invalidates the frame (STATE_OVERFLOW).
    uint last_pass;
    uint splat_stride;
    // Only read with STRIPS.
    vec3 background;
#ifdef LENSES
    // Panoramas: see seam.glsl.
    uint whole_width;
#endif
};

#include "splat_record.glsl"
#include "dispatch_range.glsl"
#include "tile_order.glsl"
#include "strips.glsl"

// Records the longest tile, and sets STATE_OVERFLOW for a tile that the last pass does not finish.
void note_tile(uint entries, uint end) {
    if (first_entry == 0) {
        atomicMax(state[STATE_LONGEST_TILE], entries);
    }
    if (last_pass != 0 && end < entries) {
        state[STATE_OVERFLOW] = 1;
    }
}

// Loads a pixel: a fresh one in the first pass, otherwise the previous pass's state.
Pixel load_pixel(uvec2 at) {
    bool inside = at.x < image_width && at.y < image_height;
    Pixel pixel = fresh_pixel(inside);
    uint index = inside ? at.y * image_width + at.x : 0;
    if (DEPTH_LIMIT) {
        pixel.least_inverse_z = depth_limits[index];
    }
    // Reads no state outside the picture, because other lanes may be writing it.
    if (first_entry > 0 && inside) {
        vec4 before = accumulated[index];
        pixel.color = before.xyz;
        pixel.transmittance = before.w;
        if (LAST_ENTRIES) {
            pixel.last = last_entries[index];
        }
        if (INVERSE_DEPTH) {
            pixel.depth = depth_sums[index];
        }
#ifdef AUXILIARY
        load_extra(index, pixel.extra);
#endif
    }
    return pixel;
}

// If another pass follows, keeps the sign of T, which marks pixels that have stopped.
void store_pixel(uvec2 at, Pixel pixel, bool more) {
    if (at.x < image_width && at.y < image_height) {
        uint index = at.y * image_width + at.x;
        // Depth losses read the transmittance.
        if (!STRIPS || more || INVERSE_DEPTH) {
            accumulated[index] = vec4(pixel.color, more ? pixel.transmittance : abs(pixel.transmittance));
        }
        if (LAST_ENTRIES) {
            last_entries[index] = pixel.last;
        }
        if (INVERSE_DEPTH) {
            depth_sums[index] = pixel.depth;
        }
#ifdef AUXILIARY
        store_extra(index, pixel.extra);
#endif
    }
}

// Stores four rows of a column, the first a multiple of 4. Rows below the picture are 0.
void store_composited(uvec2 at, Pixel pixels[4]) {
    if (at.x < image_width && at.y / STRIP_ROWS < strips_of_image()) {
        [[unroll]] for (uint channel = 0; channel < 3; ++channel) {
            vec4 values;
            [[unroll]] for (uint k = 0; k < 4; ++k) {
                float value = pixels[k].color[channel] + abs(pixels[k].transmittance) * background[channel];
                values[k] = at.y + k < image_height ? value : 0.0;
            }
            VEC4_PUT(composited, strip_texel(channel, at), values);
        }
    }
}
