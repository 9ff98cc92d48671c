// The same as ssim_backward.comp without shared memory and barriers: for processors, where a value that goes through
// memory costs as much as ten multiplications.
//
// invocation: STRIP columns and `rows` rows of one channel, see ssim_sweep.glsl; subgroup, workgroup: nothing in common
// in, planes: rendered_planes, photo_planes as ssim_planes.comp leaves them, derivatives as ssim_forward_sweep.comp does;
//     PerPixel: photo, only where it is MASKED;
// out, PerPixel: image_gradient[4 * pixel + channel]
// shared: none; any subgroup size; reads texels
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_control_flow_attributes : require
#extension GL_EXT_samplerless_texture_functions : require
#extension GL_EXT_shader_explicit_arithmetic_types_int64 : require
#extension GL_GOOGLE_include_directive : require

layout(constant_id = 0) const uint WORKGROUP_SIZE = 32;
// Columns of one invocation: a multiple of 4.
layout(constant_id = 2) const uint STRIP = 8;
// The photograph's planes are floats instead of bytes.
layout(constant_id = 3) const bool FLOAT_PHOTO = false;
// The fourth byte of a photograph's pixel is 0 where it does not count.
layout(constant_id = 4) const bool MASKED = false;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0) uniform textureBuffer rendered_planes;
layout(set = 0, binding = 1) uniform utextureBuffer photo_planes;
layout(set = 0, binding = 2) uniform textureBuffer derivatives;
layout(set = 0, binding = 3) uniform utextureBuffer photo;
layout(set = 0, binding = 4, scalar) writeonly buffer ImageGradient { float image_gradient[]; };

layout(push_constant, scalar) uniform Push {
    uint image_width;
    uint image_height;
    // Groups of columns of a plane.
    uint groups;
    uint first_channel;
    // Of all channels of the dispatch.
    uint invocations;
    // Rows of one invocation.
    uint rows;
    float lambda_dssim;
};

#define SWEPT vec3

#include "ssim.glsl"
#include "ssim_planes.glsl"
#include "ssim_photo.glsl"
#include "dispatch.glsl"
#include "ssim_sweep.glsl"
#include "ssim_derivatives.glsl"

void main() {
    Sweep sweep = sweep_of_invocation();
    // The first plane of derivatives of this channel.
    uint plane = 3 * (sweep.channel - first_channel);
    float scale = 1.0 / (3.0 * float(image_width) * float(image_height));
    for (int y = sweep.first.y - int(SSIM_RADIUS); y < sweep.first.y + int(rows + SSIM_RADIUS); ++y) {
        bool inside_y = y >= 0 && y < int(image_height);
        uint row = uint(inside_y ? y : 0) * GROUP_TEXELS;
        vec4 mean_square[MEAN_SQUARE_TEXELS], product[PRODUCT_TEXELS];
        [[unroll]] for (uint t = 0; t < MEAN_SQUARE_TEXELS; ++t) {
            uint column = uint(sweep.first.x) / 2 + t;
            mean_square[t] = texelFetch(derivatives, int(plane_texel(plane, column) + row));
        }
        [[unroll]] for (uint t = 0; t < PRODUCT_TEXELS; ++t) {
            product[t] = texelFetch(derivatives, int(sweep_texel(sweep, plane + 2, t, 0) + row));
        }
        [[unroll]] for (uint k = 0; k < SWEEP_ROW; ++k) {
            int x = sweep.first.x + int(k) - int(SSIM_RADIUS);
            bool inside = inside_y && x >= 0 && x < int(image_width);
            uint p = k + BY_PRODUCT - SSIM_RADIUS;
            vec3 value = vec3(mean_square[k / 2][k % 2 * 2], mean_square[k / 2][k % 2 * 2 + 1], product[p / 4][p % 4]);
            sweep_row[k] = inside ? value : vec3(0.0);
        }
        int complete_y = y - int(SSIM_RADIUS);
        bool complete = sweep.exists && complete_y >= sweep.first.y && complete_y < sweep.end_y;
        vec4 rendered[OWN_TEXELS], taken[OWN_TEXELS];
        [[unroll]] for (uint t = 0; t < OWN_TEXELS; ++t) {
            uint own = sweep_texel(sweep, sweep.channel, SSIM_RADIUS / 4 + t, complete ? complete_y : 0);
            rendered[t] = texelFetch(rendered_planes, int(own));
            taken[t] = photo_texel(own);
        }
        [[unroll]] for (uint c = 0; c < STRIP; ++c) {
            uint x = uint(sweep.first.x) + c;
            uint k = c + SSIM_RADIUS % 4;
            vec2 value = vec2(rendered[k / 4][k % 4], taken[k / 4][k % 4]);
            float gradient = loss_gradient(sweep_window(c), value, scale, lambda_dssim);
            if (complete && x < image_width) {
                uint pixel = uint(complete_y) * image_width + x;
                bool counts = !MASKED || texelFetch(photo, int(pixel)).x >> 24 != 0;
                image_gradient[4 * pixel + sweep.channel] = counts ? gradient : 0.0;
            }
        }
    }
}
