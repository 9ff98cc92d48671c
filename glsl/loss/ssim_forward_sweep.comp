// The same as ssim_forward.comp without shared memory and barriers: for processors, where a value that goes through
// memory costs as much as ten multiplications.
//
// invocation: STRIP columns and `rows` rows of one channel, see ssim_sweep.glsl; subgroup, workgroup: nothing in common
// in, PerPixel: accumulated (r, g, b, T), photo (RGBA8); out, PerPixel and channel (channel * pixels + pixel, from the
//     first channel of the dispatch): derivatives of SSIM by the windowed x, x^2 and x y, and a 0;
//     loss_partials[first_partial + invocation] = sums of (|x - y|, SSIM)
// shared: none; any subgroup size; reads texels
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_control_flow_attributes : require
#extension GL_EXT_samplerless_texture_functions : require
#extension GL_GOOGLE_include_directive : require

layout(constant_id = 0) const uint WORKGROUP_SIZE = 32;
// Columns of one invocation.
layout(constant_id = 2) const uint STRIP = 8;
// The photograph is three floats per pixel instead of RGBA8.
layout(constant_id = 3) const bool FLOAT_PHOTO = false;
// The fourth byte of a photograph's pixel is 0 where it does not count.
layout(constant_id = 4) const bool MASKED = false;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0) uniform textureBuffer accumulated;
layout(set = 0, binding = 1) uniform utextureBuffer photo;
layout(set = 0, binding = 2, scalar) writeonly buffer Derivatives { vec4 derivatives[]; };
layout(set = 0, binding = 3, scalar) writeonly buffer LossPartials { vec2 loss_partials[]; };

layout(push_constant, scalar) uniform Push {
    uint image_width;
    uint image_height;
    vec3 background;
    uint first_channel;
    // Of all channels of the dispatch.
    uint invocations;
    // Rows of one invocation.
    uint rows;
    // Where the partial sums of the dispatch begin.
    uint first_partial;
};

#define SWEPT vec4

vec4 accumulated_at(uint pixel) {
    return texelFetch(accumulated, int(pixel));
}

uint photo_word(uint index) {
    return texelFetch(photo, int(index)).x;
}

#include "ssim.glsl"
#include "dispatch.glsl"
#include "ssim_sweep.glsl"

void main() {
    Sweep sweep = sweep_of_invocation();
    uint plane = (sweep.channel - first_channel) * image_height;
    vec2 sum = vec2(0.0);
    for (int y = sweep.first.y - int(SSIM_RADIUS); y < sweep.first.y + int(rows + SSIM_RADIUS); ++y) {
        bool inside_y = y >= 0 && y < int(image_height);
        [[unroll]] for (uint k = 0; k < SWEEP_ROW; ++k) {
            int x = sweep.first.x + int(k) - int(SSIM_RADIUS);
            bool inside = inside_y && x >= 0 && x < int(image_width);
            uint index = inside ? uint(y) * image_width + uint(x) : 0;
            vec2 value = rendered_and_photo(index, sweep.channel);
            sweep_row[k] = ssim_moments(inside ? value : vec2(0.0));
        }
        bool own = sweep.exists && y >= sweep.first.y && y < sweep.end_y;
        int complete_y = y - int(SSIM_RADIUS);
        bool complete = sweep.exists && complete_y >= sweep.first.y && complete_y < sweep.end_y;
        [[unroll]] for (uint c = 0; c < STRIP; ++c) {
            uint x = uint(sweep.first.x) + c;
            vec2 value = sweep_row[c + SSIM_RADIUS].xy;
            sum.x += own && x < image_width ? abs(value.x - value.y) : 0.0;
            vec3 d;
            float ssim = ssim_and_derivatives(sweep_window(c), d);
            if (complete && x < image_width) {
                derivatives[(plane + uint(complete_y)) * image_width + x] = vec4(d, 0.0);
                sum.y += ssim;
            }
        }
    }
    if (sweep.exists) {
        loss_partials[first_partial + linear_invocation()] = sum;
    }
}
