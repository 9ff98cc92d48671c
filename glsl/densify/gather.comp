// Copies one plane of the Gaussians' parameters or moments: each row of the new set from its source in the old set. The halves of a
// split Gaussian get means drawn from it and scales divided by SPLIT_FACTOR; with LONG_AXIS they lie along its longest axis
// (long_axis.glsl). Clones and halves start with zero moments (paper, section 5.2; reference densify_and_split).
//
// A set changes in place through scratch of one plane: GATHER_PLACES copies rows back to their own places. Means read the other
// planes of the geometry, so they come first.
//
// invocation: one row of the new set; it returns at once if the row's source lies outside the bound range
// in: sources[row], from (PerGaussian planes); out: to (one plane: of a set, or scratch)
// shared: none; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require

#include "constants.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
// Normal numbers come from `noise`[child * noise_stride + Gaussian] instead of the generator, for comparisons.
layout(constant_id = 3) const bool EXPLICIT_NOISE = false;
layout(constant_id = 4) const bool LONG_AXIS = false;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) readonly buffer Sources { uint sources[]; };
layout(set = 0, binding = 1, scalar) readonly buffer From { uvec4 from[]; };
layout(set = 0, binding = 2, scalar) writeonly buffer To { uvec4 to[]; };
layout(set = 0, binding = 3, scalar) readonly buffer Noise { vec3 noise[]; };

layout(push_constant, scalar) uniform Push {
    uint from_first;
    uint from_count;
    uint to_first;
    uint to_count;
    // Places of the plane: see place_in.
    uvec3 from_place;
    uvec3 to_place;
    // GATHER_COPIES and so on.
    uint form;
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

vec4 geometry(uint plane, uint index) {
    return uintBitsToFloat(from[geometry_at(plane, index)]);
}

vec4 gathered_mean_opacity(uint index, uint gaussian, uint kind) {
    vec4 mean_opacity = geometry(PLANE_MEAN_OPACITY, index);
    if (kind == KIND_SPLIT_0 || kind == KIND_SPLIT_1) {
        vec4 quat = geometry(PLANE_QUAT, index);
        vec3 log_scale = geometry(PLANE_LOG_SCALE, index).xyz;
        uint child = kind == KIND_SPLIT_1 ? 1 : 0;
        if (LONG_AXIS) {
            vec3 offset = rotate(quat, long_axis_offset(log_scale));
            mean_opacity = vec4(mean_opacity.xyz + (child == 0 ? offset : -offset), long_axis_logit(mean_opacity.w));
        } else {
            vec3 normal = EXPLICIT_NOISE ? noise[child * noise_stride + gaussian]
                                         : random_normal(uvec4(seed, iteration, gaussian, child));
            mean_opacity.xyz += rotate(quat, normal * exp(log_scale));
        }
    }
    return mean_opacity;
}

vec4 gathered_log_scale(uint index, uint kind) {
    vec4 log_scale = geometry(PLANE_LOG_SCALE, index);
    if (kind == KIND_SPLIT_0 || kind == KIND_SPLIT_1) {
        log_scale.xyz = LONG_AXIS ? long_axis_log_scale(log_scale.xyz) : log_scale.xyz - LOG_SPLIT_FACTOR;
    }
    return log_scale;
}

void main() {
    uint row = linear_invocation();
    if (row >= to_count) {
        return;
    }
    uint target = place_in(to_place, row);
    if (form == GATHER_PLACES) {
        to[target] = from[place_in(from_place, row)];
        return;
    }
    uint source = sources[to_first + row];
    uint kind = source >> KIND_SHIFT;
    uint gaussian = source & ((1 << KIND_SHIFT) - 1);
    uint index = gaussian - from_first;
    if (index >= from_count) {
        return;
    }
    if (form == GATHER_MEAN_OPACITY) {
        to[target] = floatBitsToUint(gathered_mean_opacity(index, gaussian, kind));
    } else if (form == GATHER_LOG_SCALE) {
        to[target] = floatBitsToUint(gathered_log_scale(index, kind));
    } else {
        uvec4 value = from[place_in(from_place, index)];
        to[target] = form == GATHER_MOMENTS && kind != KIND_KEPT ? uvec4(0) : value;
    }
}
