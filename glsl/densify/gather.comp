// Copies each row of the new set from its source in the old set. The halves of a split Gaussian get means drawn from it and
// scales divided by SPLIT_FACTOR; with LONG_AXIS they lie along its longest axis (long_axis.glsl). Clones and halves start with
// zero moments (paper, section 5.2; reference densify_and_split).
//
// invocation: one row of the new set; it returns at once if the row's source lies outside the bound range
// in: sources[row], from (PerGaussian planes, or moments); out: to (PerGaussian planes)
// shared: none; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require

#include "constants.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
// True if the planes are the optimiser's moments, which are zero for new Gaussians.
layout(constant_id = 2) const bool MOMENTS = false;
// Normal numbers come from `noise`[child * noise_stride + Gaussian] instead of the generator, for comparisons.
layout(constant_id = 3) const bool EXPLICIT_NOISE = false;
layout(constant_id = 4) const bool LONG_AXIS = false;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) readonly buffer Sources { uint sources[]; };
layout(set = 0, binding = 1, scalar) readonly buffer From { vec4 from[]; };
layout(set = 0, binding = 2, scalar) writeonly buffer To { vec4 to[]; };
layout(set = 0, binding = 3, scalar) readonly buffer Noise { vec3 noise[]; };

layout(push_constant, scalar) uniform Push {
    uint from_first;
    uint from_count;
    uint from_chunk_gaussians;
    uint to_first;
    uint to_count;
    uint to_chunk_gaussians;
    uint planes;
    uint noise_stride;
    uint seed;
    uint iteration;
};

#include "dispatch.glsl"
#include "long_axis.glsl"
#include "planes.glsl"
#include "random.glsl"

const float LOG_SPLIT_FACTOR = log(SPLIT_FACTOR);

vec3 rotate(vec4 quat, vec3 v) {
    float norm = length(quat);
    vec4 q = norm > QUAT_NORM_MIN ? quat / norm : vec4(1.0, 0.0, 0.0, 0.0);
    return v + 2.0 * cross(q.yzw, cross(q.yzw, v) + q.x * v);
}

void main() {
    uint row = linear_invocation();
    if (row >= to_count) {
        return;
    }
    uint source = sources[to_first + row];
    uint kind = source >> KIND_SHIFT;
    uint gaussian = source & ((1 << KIND_SHIFT) - 1);
    uint index = gaussian - from_first;
    if (index >= from_count) {
        return;
    }
    bool split = kind == KIND_SPLIT_0 || kind == KIND_SPLIT_1;
    if (MOMENTS) {
        for (uint plane = 0; plane < planes; ++plane) {
            vec4 value = from[plane_at(plane, index, from_chunk_gaussians)];
            to[plane_at(plane, row, to_chunk_gaussians)] = kind == KIND_KEPT ? value : vec4(0.0);
        }
    } else {
        vec4 mean_opacity = from[plane_at(PLANE_MEAN_OPACITY, index, from_chunk_gaussians)];
        vec4 quat = from[plane_at(PLANE_QUAT, index, from_chunk_gaussians)];
        vec4 log_scale = from[plane_at(PLANE_LOG_SCALE, index, from_chunk_gaussians)];
        uint child = kind == KIND_SPLIT_1 ? 1 : 0;
        if (LONG_AXIS) {
            if (split) {
                vec3 offset = rotate(quat, long_axis_offset(log_scale.xyz));
                mean_opacity = vec4(mean_opacity.xyz + (child == 0 ? offset : -offset), long_axis_logit(mean_opacity.w));
                log_scale.xyz = long_axis_log_scale(log_scale.xyz);
            }
        } else {
            vec3 normal = EXPLICIT_NOISE ? noise[child * noise_stride + gaussian]
                                         : random_normal(uvec4(seed, iteration, gaussian, child));
            if (split) {
                mean_opacity.xyz += rotate(quat, normal * exp(log_scale.xyz));
                log_scale.xyz -= LOG_SPLIT_FACTOR;
            }
        }
        to[plane_at(PLANE_MEAN_OPACITY, row, to_chunk_gaussians)] = mean_opacity;
        to[plane_at(PLANE_QUAT, row, to_chunk_gaussians)] = quat;
        to[plane_at(PLANE_LOG_SCALE, row, to_chunk_gaussians)] = log_scale;
        for (uint plane = PLANE_SH; plane < planes; ++plane) {
            to[plane_at(plane, row, to_chunk_gaussians)] = from[plane_at(plane, index, from_chunk_gaussians)];
        }
    }
}
