// Gradient of L = weight ((1 - lambda) mean |x - y| + lambda (1 - mean SSIM)) with respect to the rendered image.
//
//   dSSIM/dx = window * by_mean + 2 x (window * by_square) + y (window * by_product)
//
// invocation: STRIP pixels in a row or column; workgroup: a 16 x 16 block of one channel (z), window separable. The first one also
// adds the `partials` of the forward pass in a fixed order; the other workgroups hide its latency
// in, PerPixel: accumulated, photo; PerPixel and channel: derivatives of ssim_forward.comp; loss_partials[partials]
// out, PerPixel: image_gradient[4 * pixel + channel]; losses[loss_row] = (weight * L, mean |x - y|, mean SSIM, unused)
// shared: 3 * (26^2 + 26 * 16) words; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_control_flow_attributes : require
#extension GL_GOOGLE_include_directive : require

layout(constant_id = 0) const uint WORKGROUP_SIZE = 128;
// Pixels in a row per invocation: a divisor of 16.
layout(constant_id = 2) const uint STRIP = 4;
// The photograph has three floats per pixel instead of RGBA8.
layout(constant_id = 3) const bool FLOAT_PHOTO = false;
// The fourth byte of a photograph's pixel is 0 at pixels that do not count.
layout(constant_id = 4) const bool MASKED = false;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) readonly buffer Accumulated { vec4 accumulated[]; };
layout(set = 0, binding = 1, scalar) readonly buffer Photo { uint photo[]; };
layout(set = 0, binding = 2, scalar) readonly buffer Derivatives { vec3 derivatives[]; };
layout(set = 0, binding = 3, scalar) writeonly buffer ImageGradient { float image_gradient[]; };
layout(set = 0, binding = 4, scalar) readonly buffer LossPartials { vec2 loss_partials[]; };
layout(set = 0, binding = 5, scalar) writeonly buffer Losses { vec4 losses[]; };

layout(push_constant, scalar) uniform Push {
    uint image_width;
    uint image_height;
    vec3 background;
    uint first_channel;
    float lambda_dssim;
    // Weight of the loss and its gradient, but not of the means.
    float weight;
    // Number of partial sums of all channels; 0 if another dispatch adds them.
    uint partials;
    uint loss_row;
};

#include "ssim.glsl"
#include "ssim_pixel.glsl"
#include "ssim_block.glsl"

// Three floats each: drivers may pad a vec3 to four, which would exceed the 16 KiB that every device has.
shared float values[3 * SSIM_APRON * SSIM_APRON];
shared float rows[3 * SSIM_APRON * SSIM_BLOCK];

vec3 value_at(uint at) {
    return vec3(values[3 * at], values[3 * at + 1], values[3 * at + 2]);
}

vec3 row_at(uint at) {
    return vec3(rows[3 * at], rows[3 * at + 1], rows[3 * at + 2]);
}

float mean_scale() {
    return 1.0 / (3.0 * float(image_width) * float(image_height));
}

// Adds the loss without subgroups, so that the driver chooses their size.
void add_partials() {
    const uint adders = min(WORKGROUP_SIZE, SSIM_BLOCK * SSIM_BLOCK);
    uint adder = gl_LocalInvocationID.x;
    vec2 sum = vec2(0.0);
    for (uint index = adder; adder < adders && index < partials; index += adders) {
        sum += loss_partials[index];
    }
    if (adder < adders) {
        rows[2 * adder] = sum.x;
        rows[2 * adder + 1] = sum.y;
    }
    barrier();
    if (adder == 0) {
        for (uint k = 1; k < adders; ++k) {
            sum += vec2(rows[2 * k], rows[2 * k + 1]);
        }
        sum *= mean_scale();
        losses[loss_row] = vec4(weight * total_loss(sum, lambda_dssim), sum, 0.0);
    }
}

void finish(vec3 windowed, uvec2 pixel, uint channel) {
    if (pixel.x < image_width && pixel.y < image_height) {
        float scale = weight * mean_scale();
        uint index = pixel.y * image_width + pixel.x;
        vec2 value = rendered_and_photo(index, channel);
        float gradient = loss_gradient(windowed, value, scale, lambda_dssim);
        image_gradient[4 * index + channel] = counts(index) ? gradient : 0.0;
    }
}

void main() {
    if (partials > 0 && gl_WorkGroupID == uvec3(0)) {
        add_partials();
    }
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
        vec3 value = derivatives[gl_WorkGroupID.z * image_height * image_width + index];
        uint to = 3 * (place.y * SSIM_APRON + place.x);
        values[to] = inside ? value.x : 0.0;
        values[to + 1] = inside ? value.y : 0.0;
        values[to + 2] = inside ? value.z : 0.0;
    }
    barrier();
    [[unroll]] for (uint round = 0; round < SSIM_APRON * SSIM_STRIPS; round += WORKGROUP_SIZE) {
        uint at = round + gl_LocalInvocationID.x;
        if (at >= SSIM_APRON * SSIM_STRIPS) {
            continue;
        }
        uint row = at / SSIM_STRIPS;
        uint column = at % SSIM_STRIPS * STRIP;
        vec3 window[SSIM_WINDOW_OF_STRIP];
        [[unroll]] for (uint k = 0; k < SSIM_WINDOW_OF_STRIP; ++k) {
            window[k] = value_at(row * SSIM_APRON + column + k);
        }
        [[unroll]] for (uint k = 0; k < STRIP; ++k) {
            vec3 sum = vec3(0.0);
            [[unroll]] for (uint tap = 0; tap < SSIM_TAPS; ++tap) {
                sum += SSIM_WINDOW[tap] * window[k + tap];
            }
            uint to = 3 * (row * SSIM_BLOCK + column + k);
            rows[to] = sum.x;
            rows[to + 1] = sum.y;
            rows[to + 2] = sum.z;
        }
    }
    barrier();
    [[unroll]] for (uint round = 0; round < SSIM_BLOCK * SSIM_STRIPS; round += WORKGROUP_SIZE) {
        uint at = round + gl_LocalInvocationID.x;
        if (at >= SSIM_BLOCK * SSIM_STRIPS) {
            continue;
        }
        uint column = at % SSIM_BLOCK;
        uint row = at / SSIM_BLOCK * STRIP;
        vec3 window[SSIM_WINDOW_OF_STRIP];
        [[unroll]] for (uint k = 0; k < SSIM_WINDOW_OF_STRIP; ++k) {
            window[k] = row_at((row + k) * SSIM_BLOCK + column);
        }
        [[unroll]] for (uint k = 0; k < STRIP; ++k) {
            vec3 windowed = vec3(0.0);
            [[unroll]] for (uint tap = 0; tap < SSIM_TAPS; ++tap) {
                windowed += SSIM_WINDOW[tap] * window[k + tap];
            }
            finish(windowed, uvec2(origin) + uvec2(column, row + k), channel);
        }
    }
}
