// Same as ssim_forward.comp, without shared memory and barriers. For processors, where a memory access costs as much as ten
// multiplications.
//
// invocation: `columns` columns of a strip of one channel, see ssim_sweep.glsl; subgroup, workgroup: nothing shared
// in, strips: rendered, photo, see ssim_columns.glsl; out, strips for each channel of the dispatch: derivatives of SSIM with
//     respect to the windowed x, x^2 and x y, see ssim_derivatives.glsl; loss_partials[first_partial + invocation] = sums of
//     (|x - y|, SSIM)
// shared: none; any subgroup size; reads texels, writes columns
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_control_flow_attributes : require
#extension GL_EXT_samplerless_texture_functions : require
#extension GL_EXT_shader_explicit_arithmetic_types_int64 : require
#extension GL_GOOGLE_include_directive : require

layout(constant_id = 0) const uint WORKGROUP_SIZE = 32;
// The photograph's planes are floats instead of bytes.
layout(constant_id = 3) const bool FLOAT_PHOTO = false;
// Some pixels do not count: they are 0 in both pictures.
layout(constant_id = 4) const bool MASKED = false;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0) uniform textureBuffer rendered;
layout(set = 0, binding = 1) uniform textureBuffer photo;
layout(set = 0, binding = 2, scalar) writeonly buffer Derivatives { u64vec4 derivatives[]; };
layout(set = 0, binding = 3, scalar) writeonly buffer LossPartials { vec2 loss_partials[]; };

layout(push_constant, scalar) uniform Push {
    uint image_width;
    uint image_height;
    uint first_channel;
    // Number of invocations for all channels of the dispatch.
    uint invocations;
    // Number of columns per invocation.
    uint columns;
    // Index of the dispatch's first partial sum.
    uint first_partial;
};

#define SWEPT vec4

#include "ssim.glsl"
#include "constants.glsl"
#include "strips.glsl"
#include "column_writes.glsl"
#include "dispatch.glsl"
#include "ssim_columns.glsl"
#include "ssim_sweep.glsl"
#include "ssim_derivatives.glsl"

void main() {
    Sweep sweep = sweep_of_invocation();
    uint to = DERIVATIVES * strip_column(sweep.channel - first_channel, sweep.strip, 0);
    vec2 sum = vec2(0.0);
    for (int x = sweep.first_x - int(SSIM_RADIUS); x < sweep.first_x + int(columns + SSIM_RADIUS); ++x) {
        bool inside = x >= 0 && x < int(image_width);
        uint at_x = uint(inside ? x : 0);
        uvec3 at = sweep_columns(sweep, sweep.channel, at_x);
        uvec3 mask_at = MASKED ? sweep_columns(sweep, MASK_PLANE, at_x) : uvec3(0);
        vec2 values[STRIP_ROWS];
        read_column(at.x, mask_at.x, values);
        [[unroll]] for (uint k = 0; k < SSIM_RADIUS; ++k) {
            bool exists = inside && sweep.has_above;
            sweep_values[k] = ssim_moments(exists ? values[STRIP_ROWS - SSIM_RADIUS + k] : vec2(0.0));
        }
        read_column(at.z, mask_at.z, values);
        [[unroll]] for (uint k = 0; k < SSIM_RADIUS; ++k) {
            bool exists = inside && sweep.has_below;
            sweep_values[SSIM_RADIUS + STRIP_ROWS + k] = ssim_moments(exists ? values[k] : vec2(0.0));
        }
        read_column(at.y, mask_at.y, values);
        [[unroll]] for (uint k = 0; k < STRIP_ROWS; ++k) {
            sweep_values[SSIM_RADIUS + k] = ssim_moments(inside ? values[k] : vec2(0.0));
        }
        bool own = sweep.exists && x >= sweep.first_x && x < sweep.end_x;
        int complete_x = x - int(SSIM_RADIUS);
        bool complete = sweep.exists && complete_x >= sweep.first_x && complete_x < sweep.end_x;
        float found[DERIVATIVES * STRIP_ROWS];
        [[unroll]] for (uint row = 0; row < STRIP_ROWS; ++row) {
            bool exists = sweep.strip * STRIP_ROWS + row < image_height;
            sum.x += own && exists ? abs(values[row].x - values[row].y) : 0.0;
            vec3 d;
            float ssim = ssim_and_derivatives(sweep_window(row), d);
            sum.y += complete && exists ? ssim : 0.0;
            [[unroll]] for (uint k = 0; k < DERIVATIVES; ++k) {
                found[DERIVATIVES * row + k] = exists ? d[k] : 0.0;
            }
        }
        if (complete) {
            uint place = to + DERIVATIVES * uint(complete_x);
            [[unroll]] for (uint k = 0; k < DERIVATIVES; ++k) {
                float part[STRIP_ROWS];
                [[unroll]] for (uint i = 0; i < STRIP_ROWS; ++i) {
                    part[i] = found[STRIP_ROWS * k + i];
                }
                derivatives[place + k] = eight(part);
            }
        }
    }
    if (sweep.exists) {
        loss_partials[first_partial + linear_invocation()] = sum;
    }
}
