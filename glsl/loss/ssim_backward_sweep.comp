// Same as ssim_backward.comp, without shared memory and barriers. For processors, where a memory access costs as much as ten
// multiplications.
//
// invocation: `columns` columns of a strip of one channel, see ssim_sweep.glsl; subgroup, workgroup: nothing shared
// in, strips: rendered, photo, see ssim_columns.glsl, derivatives as ssim_forward_sweep.comp writes them; out, strips:
//     image_gradient, a plane for each channel, undefined below the picture
// One additional workgroup adds the `partials` of the forward pass like ssim_backward.comp.
// shared: none; any subgroup size; reads texels, writes columns
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_control_flow_attributes : require
#extension GL_EXT_samplerless_texture_functions : require
#extension GL_EXT_shader_explicit_arithmetic_types_int64 : require
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require

layout(constant_id = 0) const uint WORKGROUP_SIZE = 32;
layout(constant_id = 1) const uint SUBGROUP_SIZE = 32;
// The photograph's planes are floats instead of bytes.
layout(constant_id = 3) const bool FLOAT_PHOTO = false;
// Some pixels do not count: they are 0 in both pictures.
layout(constant_id = 4) const bool MASKED = false;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0) uniform textureBuffer rendered;
layout(set = 0, binding = 1) uniform textureBuffer photo;
layout(set = 0, binding = 2) uniform textureBuffer derivatives;
layout(set = 0, binding = 3, scalar) writeonly buffer ImageGradient { u64vec4 image_gradient[]; };

layout(set = 0, binding = 4, scalar) readonly buffer LossPartials { vec2 loss_partials[]; };
layout(set = 0, binding = 5, scalar) writeonly buffer Losses { vec4 losses[]; };

layout(push_constant, scalar) uniform Push {
    uint image_width;
    uint image_height;
    uint first_channel;
    // Number of invocations for all channels of the dispatch.
    uint invocations;
    // Number of columns per invocation.
    uint columns;
    float lambda_dssim;
    // Number of partial sums of all channels; 0 if another dispatch adds them.
    uint partials;
    uint loss_row;
    // Weight of the loss and its gradient, but not of the means.
    float weight;
};

#define SWEPT vec3

#include "ssim.glsl"
#include "constants.glsl"
#include "strips.glsl"
#include "column_writes.glsl"
#include "dispatch.glsl"
#include "ssim_columns.glsl"
#include "ssim_sweep.glsl"
#include "ssim_derivatives.glsl"

// A column of derivatives.
vec4 derivative_texels[DERIVATIVE_TEXELS];

vec3 derivatives_at(uint row) {
    vec3 values;
    [[unroll]] for (uint k = 0; k < DERIVATIVES; ++k) {
        uint i = DERIVATIVES * row + k;
        values[k] = derivative_texels[i / 4][i % 4];
    }
    return values;
}

// Adds the loss with one subgroup, in a fixed order.
void add_partials(float scale) {
    vec2 sum = vec2(0.0);
    for (uint index = gl_SubgroupInvocationID; index < partials; index += SUBGROUP_SIZE) {
        sum += loss_partials[index];
    }
    sum = subgroupAdd(sum) * scale;
    if (gl_LocalInvocationID.x == 0) {
        losses[loss_row] = vec4(weight * total_loss(sum, lambda_dssim), sum, 0.0);
    }
}

void main() {
    float scale = 1.0 / (3.0 * float(image_width) * float(image_height));
    if (partials > 0 && linear_workgroup() == (invocations + WORKGROUP_SIZE - 1) / WORKGROUP_SIZE) {
        add_partials(scale);
        return;
    }
    Sweep sweep = sweep_of_invocation();
    uint own = strip_column(sweep.channel, sweep.strip, 0);
    uint own_mask = strip_column(MASK_PLANE, sweep.strip, 0);
    for (int x = sweep.first_x - int(SSIM_RADIUS); x < sweep.first_x + int(columns + SSIM_RADIUS); ++x) {
        bool inside = x >= 0 && x < int(image_width);
        uvec3 at = DERIVATIVE_TEXELS * sweep_columns(sweep, sweep.channel - first_channel, uint(inside ? x : 0));
        [[unroll]] for (uint t = FIRST_DERIVATIVE_TEXEL_ABOVE; t < DERIVATIVE_TEXELS; ++t) {
            derivative_texels[t] = texelFetch(derivatives, int(at.x + t));
        }
        [[unroll]] for (uint k = 0; k < SSIM_RADIUS; ++k) {
            sweep_values[k] = inside && sweep.has_above ? derivatives_at(STRIP_ROWS - SSIM_RADIUS + k) : vec3(0.0);
        }
        [[unroll]] for (uint t = 0; t < END_DERIVATIVE_TEXEL_BELOW; ++t) {
            derivative_texels[t] = texelFetch(derivatives, int(at.z + t));
        }
        [[unroll]] for (uint k = 0; k < SSIM_RADIUS; ++k) {
            sweep_values[SSIM_RADIUS + STRIP_ROWS + k] = inside && sweep.has_below ? derivatives_at(k) : vec3(0.0);
        }
        [[unroll]] for (uint t = 0; t < DERIVATIVE_TEXELS; ++t) {
            derivative_texels[t] = texelFetch(derivatives, int(at.y + t));
        }
        [[unroll]] for (uint k = 0; k < STRIP_ROWS; ++k) {
            sweep_values[SSIM_RADIUS + k] = inside ? derivatives_at(k) : vec3(0.0);
        }
        int complete_x = x - int(SSIM_RADIUS);
        bool complete = sweep.exists && complete_x >= sweep.first_x && complete_x < sweep.end_x;
        uint own_x = uint(complete ? complete_x : 0);
        vec2 values[STRIP_ROWS];
        read_column(own + own_x, own_mask + own_x, values);
        uvec2 mask = uvec2(0);
        if (MASKED) mask = photo_bytes(own_mask + own_x);
        float gradient[STRIP_ROWS];
        [[unroll]] for (uint row = 0; row < STRIP_ROWS; ++row) {
            float d = loss_gradient(sweep_window(row), values[row], weight * scale, lambda_dssim);
            gradient[row] = MASKED && photo_byte(mask, row) == 0 ? 0.0 : d;
        }
        if (complete) {
            image_gradient[own + own_x] = eight(gradient);
        }
    }
}
