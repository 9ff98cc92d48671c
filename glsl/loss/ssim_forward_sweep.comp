// The same as ssim_forward.comp without shared memory and barriers: for processors, where a value that goes through
// memory costs as much as ten multiplications.
//
// invocation: STRIP columns and `rows` rows of one channel, see ssim_sweep.glsl; subgroup, workgroup: nothing in common
// in, planes: rendered_planes, photo_planes as ssim_planes.comp leaves them; out, three planes for each channel of the
//     dispatch: derivatives of SSIM by the windowed x, x^2 and x y, undefined outside of the picture;
//     loss_partials[first_partial + invocation] = sums of (|x - y|, SSIM)
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
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0) uniform textureBuffer rendered_planes;
layout(set = 0, binding = 1) uniform utextureBuffer photo_planes;
layout(set = 0, binding = 2, scalar) writeonly buffer Derivatives { uint64_t derivatives[]; };
layout(set = 0, binding = 3, scalar) writeonly buffer LossPartials { vec2 loss_partials[]; };

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
    // Where the partial sums of the dispatch begin.
    uint first_partial;
};

#define SWEPT vec4

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
    vec2 sum = vec2(0.0);
    for (int y = sweep.first.y - int(SSIM_RADIUS); y < sweep.first.y + int(rows + SSIM_RADIUS); ++y) {
        bool inside = y >= 0 && y < int(image_height);
        [[unroll]] for (uint t = 0; t < SWEEP_TEXELS; ++t) {
            uint texel = sweep_texel(sweep, sweep.channel, t, inside ? y : 0);
            vec4 rendered = texelFetch(rendered_planes, int(texel));
            vec4 photo = photo_texel(texel);
            [[unroll]] for (uint k = 0; k < 4; ++k) {
                if (4 * t + k < SWEEP_ROW) {
                    vec2 value = vec2(rendered[k], photo[k]);
                    sweep_row[4 * t + k] = ssim_moments(inside ? value : vec2(0.0));
                }
            }
        }
        bool own = sweep.exists && y >= sweep.first.y && y < sweep.end_y;
        int complete_y = y - int(SSIM_RADIUS);
        bool complete = sweep.exists && complete_y >= sweep.first.y && complete_y < sweep.end_y;
        float by_product[STRIP];
        [[unroll]] for (uint c = 0; c < STRIP; ++c) {
            bool counts = uint(sweep.first.x) + c < image_width;
            vec2 value = sweep_row[c + SSIM_RADIUS].xy;
            sum.x += own && counts ? abs(value.x - value.y) : 0.0;
            vec3 d;
            float ssim = ssim_and_derivatives(sweep_window(c), d);
            sum.y += complete && counts ? ssim : 0.0;
            by_product[c] = d.z;
            if (complete) {
                derivatives[mean_square_pair(sweep, plane, c, complete_y)] = pair(d.x, d.y);
                if (c % 2 == 1) {
                    derivatives[product_pair(sweep, plane, c - 1, complete_y)] = pair(by_product[c - 1], d.z);
                }
            }
        }
    }
    if (sweep.exists) {
        loss_partials[first_partial + linear_invocation()] = sum;
    }
}
