// The same as ssim_backward.comp without shared memory and barriers: for processors, where a value that goes through
// memory costs as much as ten multiplications.
//
// invocation: STRIP columns and `rows` rows of one channel, see ssim_sweep.glsl; subgroup, workgroup: nothing in common
// in, PerPixel: accumulated, photo; PerPixel and channel: derivatives as ssim_forward_sweep.comp leaves them;
// out, PerPixel: image_gradient[4 * pixel + channel]
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
layout(set = 0, binding = 2) uniform textureBuffer derivatives;
layout(set = 0, binding = 3, scalar) writeonly buffer ImageGradient { float image_gradient[]; };

layout(push_constant, scalar) uniform Push {
    uint image_width;
    uint image_height;
    vec3 background;
    uint first_channel;
    // Of all channels of the dispatch.
    uint invocations;
    // Rows of one invocation.
    uint rows;
    float lambda_dssim;
};

#define SWEPT vec3

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
    float scale = 1.0 / (3.0 * float(image_width) * float(image_height));
    for (int y = sweep.first.y - int(SSIM_RADIUS); y < sweep.first.y + int(rows + SSIM_RADIUS); ++y) {
        bool inside_y = y >= 0 && y < int(image_height);
        [[unroll]] for (uint k = 0; k < SWEEP_ROW; ++k) {
            int x = sweep.first.x + int(k) - int(SSIM_RADIUS);
            bool inside = inside_y && x >= 0 && x < int(image_width);
            uint index = inside ? (plane + uint(y)) * image_width + uint(x) : 0;
            vec3 value = texelFetch(derivatives, int(index)).xyz;
            sweep_row[k] = inside ? value : vec3(0.0);
        }
        int complete_y = y - int(SSIM_RADIUS);
        bool complete = sweep.exists && complete_y >= sweep.first.y && complete_y < sweep.end_y;
        [[unroll]] for (uint c = 0; c < STRIP; ++c) {
            uint x = uint(sweep.first.x) + c;
            bool inside = complete && x < image_width;
            uint index = inside ? uint(complete_y) * image_width + x : 0;
            vec2 value = rendered_and_photo(index, sweep.channel);
            float gradient = loss_gradient(sweep_window(c), value, scale, lambda_dssim);
            if (inside) {
                image_gradient[4 * index + sweep.channel] = counts(index) ? gradient : 0.0;
            }
        }
    }
}
