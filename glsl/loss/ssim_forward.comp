// L1 and SSIM between the rendered image and the photograph, and SSIM's derivatives for the backward pass (reference:
// loss_utils.py; Wang et al. 2004).
//
//   SSIM = (2 mx my + C1)(2 sxy + C2) / ((mx^2 + my^2 + C1)(sx^2 + sy^2 + C2)), means and variances under the window
//
// invocation: STRIP pixels in a row or column; workgroup: a 16 x 16 block of one channel (z), window separable
// in, PerPixel: accumulated (r, g, b, T), photo (RGBA8); out, PerPixel and channel (channel * pixels + pixel, from the
//     first channel of the dispatch): derivatives of SSIM with respect to the windowed x, x^2 and x y;
//     loss_partials[workgroup] = sums of (|x - y|, SSIM)
// shared: 2 * 26^2 + 4 * 26 * 16 words and two per subgroup; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_control_flow_attributes : require
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require

layout(constant_id = 0) const uint WORKGROUP_SIZE = 128;
layout(constant_id = 1) const uint SUBGROUP_SIZE = 32;
// Pixels in a row per invocation: a divisor of 16.
layout(constant_id = 2) const uint STRIP = 4;
// The photograph has three floats per pixel instead of RGBA8.
layout(constant_id = 3) const bool FLOAT_PHOTO = false;
// The fourth byte of a photograph's pixel is 0 at pixels that do not count.
layout(constant_id = 4) const bool MASKED = false;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) readonly buffer Accumulated { vec4 accumulated[]; };
layout(set = 0, binding = 1, scalar) readonly buffer Photo { uint photo[]; };
layout(set = 0, binding = 2, scalar) writeonly buffer Derivatives { vec3 derivatives[]; };
layout(set = 0, binding = 3, scalar) writeonly buffer LossPartials { vec2 loss_partials[]; };

layout(push_constant, scalar) uniform Push {
    uint image_width;
    uint image_height;
    vec3 background;
    uint first_channel;
};

#include "ssim.glsl"
#include "ssim_pixel.glsl"
#include "ssim_block.glsl"
#include "workgroup_sum.glsl"

shared vec2 values[SSIM_APRON * SSIM_APRON];
shared vec4 rows[SSIM_APRON * SSIM_BLOCK];

// Writes the derivatives at a pixel. Returns (|x - y|, SSIM).
vec2 finish(vec4 moments, vec2 value, uvec2 pixel) {
    vec3 d;
    float ssim = ssim_and_derivatives(moments, d);
    bool inside = pixel.x < image_width && pixel.y < image_height;
    if (inside) {
        derivatives[(gl_WorkGroupID.z * image_height + pixel.y) * image_width + pixel.x] = d;
    }
    return inside ? vec2(abs(value.x - value.y), ssim) : vec2(0.0);
}

void main() {
    uint channel = first_channel + gl_WorkGroupID.z;
    ivec2 size = ivec2(image_width, image_height);
    ivec2 origin = ivec2(gl_WorkGroupID.xy * SSIM_BLOCK);
    // Rows of SSIM_PITCH avoid a division and leave few lanes idle.
    [[unroll]] for (uint round = 0; round < SSIM_APRON * SSIM_PITCH; round += WORKGROUP_SIZE) {
        uint at = round + gl_LocalInvocationID.x;
        uvec2 place = uvec2(at % SSIM_PITCH, at / SSIM_PITCH);
        if (place.x >= SSIM_APRON || place.y >= SSIM_APRON) {
            continue;
        }
        ivec2 pixel = origin + ivec2(place) - int(SSIM_RADIUS);
        bool inside = all(greaterThanEqual(pixel, ivec2(0))) && all(lessThan(pixel, size));
        uint index = inside ? uint(pixel.y) * image_width + uint(pixel.x) : 0;
        values[place.y * SSIM_APRON + place.x] = inside ? rendered_and_photo(index, channel) : vec2(0.0);
    }
    barrier();
    [[unroll]] for (uint round = 0; round < SSIM_APRON * SSIM_STRIPS; round += WORKGROUP_SIZE) {
        uint at = round + gl_LocalInvocationID.x;
        if (at >= SSIM_APRON * SSIM_STRIPS) {
            continue;
        }
        uint row = at / SSIM_STRIPS;
        uint column = at % SSIM_STRIPS * STRIP;
        vec4 window[SSIM_WINDOW_OF_STRIP];
        [[unroll]] for (uint k = 0; k < SSIM_WINDOW_OF_STRIP; ++k) {
            window[k] = ssim_moments(values[row * SSIM_APRON + column + k]);
        }
        [[unroll]] for (uint k = 0; k < STRIP; ++k) {
            vec4 moments = vec4(0.0);
            [[unroll]] for (uint tap = 0; tap < SSIM_TAPS; ++tap) {
                moments += SSIM_WINDOW[tap] * window[k + tap];
            }
            rows[row * SSIM_BLOCK + column + k] = moments;
        }
    }
    barrier();
    vec2 sum = vec2(0.0);
    [[unroll]] for (uint round = 0; round < SSIM_BLOCK * SSIM_STRIPS; round += WORKGROUP_SIZE) {
        uint at = round + gl_LocalInvocationID.x;
        if (at >= SSIM_BLOCK * SSIM_STRIPS) {
            continue;
        }
        uint column = at % SSIM_BLOCK;
        uint row = at / SSIM_BLOCK * STRIP;
        vec4 window[SSIM_WINDOW_OF_STRIP];
        [[unroll]] for (uint k = 0; k < SSIM_WINDOW_OF_STRIP; ++k) {
            window[k] = rows[(row + k) * SSIM_BLOCK + column];
        }
        [[unroll]] for (uint k = 0; k < STRIP; ++k) {
            vec4 moments = vec4(0.0);
            [[unroll]] for (uint tap = 0; tap < SSIM_TAPS; ++tap) {
                moments += SSIM_WINDOW[tap] * window[k + tap];
            }
            vec2 value = values[(row + k + SSIM_RADIUS) * SSIM_APRON + column + SSIM_RADIUS];
            sum += finish(moments, value, uvec2(origin) + uvec2(column, row + k));
        }
    }
    vec2 total = workgroup_sum(sum, vec2(0.0));
    if (gl_LocalInvocationID.x == 0) {
        uint workgroup = (channel * gl_NumWorkGroups.y + gl_WorkGroupID.y) * gl_NumWorkGroups.x + gl_WorkGroupID.x;
        loss_partials[workgroup] = total;
    }
}
