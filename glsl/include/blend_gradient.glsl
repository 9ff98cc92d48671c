// Backward pass of blending for the pixels of one lane: buffers, push constants, and the gradient of one Gaussian. All variants
// of the kernel share it; they differ in the addition over lanes and regions. blend_backward.comp has the derivative.
//
// Needs constants.glsl, buffers.glsl, SUBGROUP_SIZE, REGION_HEIGHT, INVERSE_DEPTH, INCREMENTAL_EXP, COUNT_HITS, STRIPS (see
// blend_io.glsl), ABSOLUTE, WEIGHTS (see blend_backward.comp), BROADCAST, SHARED_SPLATS, OWN_REGIONS (maximum number of regions
// per lane), GL_KHR_shader_subgroup_basic, _arithmetic, _ballot and _shuffle.

// Training only draws splats: there is no host depth image and no linear depth.
const bool DEPTH_LIMIT = false;
const bool DISTANCE_ORDER = false;
const bool LINEAR_DEPTH = false;
const bool LAST_ENTRIES = false;

layout(set = 0, binding = 0, scalar) readonly buffer TileRanges { uvec2 tile_ranges[]; };
UINT_READS(1, SortedVisible, sorted_visible);
UINT_READS(2, SortedInstances, sorted_instances);
VEC4_READS(3, Mean2dExtent, mean2d_extent);
VEC4_READS(4, ConicOpacity, conic_opacity);
VEC4_READS(5, ColorInverseDepth, color_inverse_depth);
// Per pixel (r, g, b without background, T); with STRIPS three planes of the composited picture.
VEC4_READS(6, Rendered, rendered);
FLOAT_READS(7, DepthSums, depth_sums);
UINT_READS(8, LastEntries, last_entries);
// dL/d(r, g, b, inverse depth) per pixel; with STRIPS three planes of them, or four with INVERSE_DEPTH.
VEC4_READS(9, ImageGradient, image_gradient);
layout(set = 0, binding = 10, scalar) buffer BackwardState { vec2 backward_state[]; };
layout(set = 0, binding = 11, scalar) writeonly buffer InstanceGradientsA { vec4 instance_gradients_a[]; };
layout(set = 0, binding = 12, scalar) writeonly buffer InstanceGradientsB { vec4 instance_gradients_b[]; };
layout(set = 0, binding = 13, scalar) writeonly buffer InstanceGradientsC { vec2 instance_gradients_c[]; };

layout(set = 0, binding = 14, scalar) buffer State { uint state[]; };
// Only written with ABSOLUTE.
layout(set = 0, binding = 15, scalar) writeonly buffer InstanceGradientsD { vec2 instance_gradients_d[]; };

layout(push_constant, scalar) uniform Push {
    uint image_width;
    uint image_height;
    uint tiles_per_row;
    uint tile_count;
    uint first_entry;
    uint max_entries;
    // See blend_io.glsl.
    uint first_instance;
    uint max_instances;
    uint tile_row_interleave;
    vec3 background;
    uint splat_stride;
#ifdef LENSES
    // Panoramas: see seam.glsl.
    uint whole_width;
#endif
};

#ifdef LENSES
#define PROJECTION PROJECTION_EQUIRECTANGULAR
#include "seam.glsl"
#endif

#include "splat_record.glsl"
#include "dispatch_range.glsl"
#include "tile_order.glsl"
#include "strips.glsl"
#include "tile_region.glsl"
#include "blending.glsl"
#include "splat_shuffle.glsl"

// Maximum number of pixels of a lane in a region. A literal for the same reason as MAX_COLUMN_ROWS.
const uint MAX_PIXELS = 16;

const float LN_2 = 0.6931471805599453;

// With COUNT_HITS: number of Gaussians blended over a region.
uint hit_count = 0;

void note_hits() {
    if (COUNT_HITS && gl_SubgroupInvocationID == 0) {
        atomicAdd(state[STATE_BLEND_BACKWARD_HITS], hit_count * (REGION_HEIGHT / 4));
    }
}

// End of the entries that a pass over [begin, pass_end) of a tile's list blends. `tile_last`: 1 + the last index of the list
// that any pixel of the tile blended. Entries behind the last one of the first scene do not count. Only that scene has
// gradients, and front to back they do not depend on later entries. If a later pass blends, it may need all entries of this
// pass. A search through all passes would exceed the loop limits of some drivers.
uint blended_end(uvec2 range, uint begin, uint pass_end, uint tile_last) {
    uint end = max(min(range.y - range.x, tile_last), begin);
    if (end > pass_end) {
        return pass_end;
    }
    uint first_scene = state[STATE_FIRST_SCENE_VISIBLE];
    // With one scene, the last entry always counts. The loop tests at its end: see blend.comp.
    if (end > begin) for (;;) {
        bool exists = gl_SubgroupInvocationID < end - begin;
        uint entry = exists ? end - 1 - gl_SubgroupInvocationID : begin;
        bool counts = exists && UINT_AT(sorted_visible, range.x + entry) < first_scene;
        uint behind = subgroupMin(counts ? gl_SubgroupInvocationID : SUBGROUP_SIZE);
        end -= min(behind, end - begin);
        if (behind < SUBGROUP_SIZE || end == begin) {
            break;
        }
    }
    return end;
}

struct GradientPixel {
    float transmittance;
    // Contribution of the remaining list to gradient . pixel.
    float rest;
    // dL/d(r, g, b, inverse depth).
    vec4 gradient;
    uint last;
};

// Pixels of the lane, its first region first. Not parameters, because these take Mesa longer to build: tools/experiments.md.
GradientPixel pixels[OWN_REGIONS * MAX_PIXELS];

// One instance's sums over the pixels, see blend_backward.comp.
struct Sums {
    // dL/dpower times 1, dx, dy; dx^2, dx dy, dy^2.
    vec3 linear;
    vec3 quadratic;
    // Sums of r, g, b, inverse depth. With WEIGHTS the first is the sum of weight * r, and the others do not count.
    vec4 value;
    // Sum over pixels of |dL/d(mean2d)|, x and y; only with ABSOLUTE.
    vec2 absolute;
};

bool is_pixel(uvec2 at) {
    return at.x < image_width && at.y < image_height;
}

// Stores a pixel's composited colour and gradient, which blending and the loss have written.
void set_pixel(uint k, vec3 color, vec4 gradient) {
    pixels[k].gradient = gradient;
    pixels[k].rest = WEIGHTS ? 0.0 : dot(gradient.xyz, color);
}

// Loads four rows of a column into pixels[first...]. The first row is a multiple of 4.
void load_four(uvec2 at, bool tile_exists, uint first) {
    bool inside = tile_exists && is_pixel(at);
    vec4 rows[7];
    [[unroll]] for (uint plane = 0; plane < 4; ++plane) {
        uint texel = inside ? strip_texel(plane, at) : 0;
        if (plane < 3) {
            rows[4 + plane] = VEC4_AT(rendered, texel);
        }
        rows[plane] = plane < 3 || INVERSE_DEPTH ? VEC4_AT(image_gradient, texel) : vec4(0.0);
    }
    [[unroll]] for (uint k = 0; k < 4; ++k) {
        // The loss writes no gradient below the picture.
        bool exists = at.y + k < image_height;
        vec4 gradient = vec4(rows[0][k], rows[1][k], rows[2][k], rows[3][k]);
        set_pixel(first + k, vec3(rows[4][k], rows[5][k], rows[6][k]), exists ? gradient : vec4(0.0));
    }
}

void load_one(uvec2 at, bool tile_exists, uint k) {
    uint index = tile_exists && is_pixel(at) ? at.y * image_width + at.x : 0;
    vec4 color = VEC4_AT(rendered, index);
    vec4 gradient = VEC4_AT(image_gradient, index);
    if (!INVERSE_DEPTH) {
        gradient.w = 0.0;
    }
    set_pixel(k, color.xyz + color.w * background, gradient);
}

// Loads the previous pass's state of a lane's pixels in a region, from the index `first` on. Returns 1 + the last list index
// that any of these pixels blended.
uint load_pixels(uvec2 corner, bool tile_exists, uint first) {
    uint lane_last = 0;
    [[unroll]] for (uint k = 0; k < PIXELS; ++k) {
        if (!STRIPS) {
            load_one(corner + pixel_step(k), tile_exists, first + k);
        } else if (k % 4 == 0) {
            load_four(corner + pixel_step(k), tile_exists, first + k);
        }
    }
    [[unroll]] for (uint k = 0; k < PIXELS; ++k) {
        uvec2 at = corner + pixel_step(k);
        bool inside = tile_exists && is_pixel(at);
        uint index = inside ? at.y * image_width + at.x : 0;
        if (INVERSE_DEPTH) {
            pixels[first + k].rest += pixels[first + k].gradient.w * FLOAT_AT(depth_sums, index);
        }
        // A pixel without a gradient, such as a masked one, adds nothing to any sum.
        bool counts = inside && pixels[first + k].gradient != vec4(0.0);
        uint last = counts ? UINT_AT(last_entries, index) : 0;
        pixels[first + k].transmittance = 1.0;
        pixels[first + k].last = last;
        lane_last = max(lane_last, last);
    }
    if (first_entry > 0) {
        [[unroll]] for (uint k = 0; k < PIXELS; ++k) {
            uvec2 at = corner + pixel_step(k);
            // Reads no state of other pixels, because their lanes may be writing it.
            if (tile_exists && is_pixel(at)) {
                vec2 before = backward_state[at.y * image_width + at.x];
                pixels[first + k].transmittance = before.x;
                pixels[first + k].rest = before.y;
            }
        }
    }
    return lane_last;
}

// Stores the state for the next pass.
void store_pixels(uvec2 corner, bool tile_exists, uint first) {
    [[unroll]] for (uint k = 0; k < PIXELS; ++k) {
        uvec2 at = corner + pixel_step(k);
        if (tile_exists && is_pixel(at)) {
            backward_state[at.y * image_width + at.x] = vec2(pixels[first + k].transmittance, pixels[first + k].rest);
        }
    }
}

// Blends a Gaussian with this weight over a pixel.
void blend_over(uint k, float alpha, float weight, inout vec4 sum_value) {
    precise float next = pixels[k].transmittance * (1.0 - alpha);
    pixels[k].transmittance = next;
    sum_value += weight * pixels[k].gradient;
}

// Gradient of the Gaussian at list index `place` over the pixels of a lane in a region, from the index `first` on. Also blends
// the Gaussian over these pixels.
Sums blend_backward(Splat splat, uint place, vec2 corner_px, uint first) {
    vec4 value = vec4(splat.rgb, splat.inverse_z);
    vec2 d0 = splat.mean - corner_px;
    float sum_1 = 0.0, sum_x = 0.0, sum_y = 0.0, sum_xx = 0.0, sum_xy = 0.0, sum_yy = 0.0;
    vec4 sum_value = vec4(0.0);
    vec2 sum_absolute = vec2(0.0);
    [[unroll]] for (uint column = 0; column < COLUMNS; ++column) {
        float dx = d0.x - float(column * LANES_X);
#ifdef LENSES
        dx = to_nearest_turn(dx);
#endif
        float alphas[MAX_COLUMN_ROWS];
        column_alphas(splat, corner_px + vec2(column * LANES_X, 0), alphas);
        float column_1 = 0.0, column_y = 0.0, column_yy = 0.0;
        [[unroll]] for (uint row = 0; row < ROWS; ++row) {
            uint k = first + column * ROWS + row;
            float dy = d0.y - float(row);
            float unclamped = place <= pixels[k].last ? alphas[row] : 0.0;
            float alpha = min(ALPHA_MAX, unclamped);
            float transmittance = pixels[k].transmittance;
            float weight = alpha * transmittance;
            if (WEIGHTS) {
                blend_over(k, alpha, weight, sum_value);
                continue;
            }
            float shade_gradient = dot(pixels[k].gradient, value);
            float rest = pixels[k].rest - weight * shade_gradient;
            pixels[k].rest = rest;
            float d_alpha = transmittance * shade_gradient - rest / (1.0 - alpha);
            float d_power = unclamped <= ALPHA_MAX ? alpha * d_alpha : 0.0;
            // Not earlier, because a processor would run out of registers (tools/experiments.md).
            blend_over(k, alpha, weight, sum_value);
            column_1 += d_power;
            column_y += d_power * dy;
            column_yy += d_power * dy * dy;
            if (ABSOLUTE) {
                // dL/d(mean2d) of this pixel is dL/dpower times -conic (dx, dy): the form has the conic times -log2(e).
                vec3 form = splat.form;
                vec2 slope = vec2(2.0 * form.x * dx + form.y * dy, form.y * dx + 2.0 * form.z * dy);
                sum_absolute += abs(d_power) * abs(slope);
            }
        }
        sum_1 += column_1;
        sum_x += column_1 * dx;
        sum_y += column_y;
        sum_xx += column_1 * dx * dx;
        sum_xy += column_y * dx;
        sum_yy += column_yy;
    }
    return Sums(vec3(sum_1, sum_x, sum_y), vec3(sum_xx, sum_xy, sum_yy), sum_value, LN_2 * sum_absolute);
}

// Writes to the instance's index before the tile sort: (1, dx, dy, dx dx), (dx dy, dy dy, r, g), (b, inverse depth), and the
// absolute gradients. With WEIGHTS only (weight, 0), as the third.
void store_instance(uint place, Sums sums) {
    uint target = UINT_AT(sorted_instances, place);
    if (WEIGHTS) {
        instance_gradients_c[target] = vec2(sums.value.x, 0.0);
        return;
    }
    instance_gradients_a[target] = vec4(sums.linear, sums.quadratic.x);
    instance_gradients_b[target] = vec4(sums.quadratic.yz, sums.value.xy);
    instance_gradients_c[target] = sums.value.zw;
    if (ABSOLUTE) {
        instance_gradients_d[target] = sums.absolute;
    }
}

Sums no_sums() {
    return Sums(vec3(0.0), vec3(0.0), vec4(0.0), vec2(0.0));
}
