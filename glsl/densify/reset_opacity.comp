// Opacity reset (paper, section 5.2; reference reset_opacity): opacity <- min(opacity, 0.01), and zero moments. With a 3D
// filter it applies to the filtered opacity (Mip-Splatting's reset_opacity).
//
// invocation: one Gaussian
// in/out: parameters, moments_1, moments_2 (PerGaussian planes; only the opacity's component changes)
// shared: none; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_spirv_intrinsics : require

#include "constants.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) buffer Parameters { vec4 parameters[]; };
// Packed moments are bound twice, so both are decorated as aliased.
spirv_decorate(20) layout(set = 0, binding = 1, scalar) buffer Moments1 { uvec4 moments_1[]; };
spirv_decorate(20) layout(set = 0, binding = 2, scalar) buffer Moments2 { uvec4 moments_2[]; };

layout(push_constant, scalar) uniform Push {
    uint count;
    // Largest opacity after the reset, and its logit.
    float max_opacity;
    float max_logit;
    // 1 for moments of packed_moments.glsl, all of which are in `moments_1`.
    uint packed_moments;
};

#include "dispatch.glsl"
#include "filter_3d.glsl"
#include "planes.glsl"

void main() {
    uint index = linear_invocation();
    if (index >= count) {
        return;
    }
    uint at = geometry_at(PLANE_MEAN_OPACITY, index);
    float logit = parameters[at].w;
    vec4 log_scale = parameters[geometry_at(PLANE_LOG_SCALE, index)];
    float limit = max_logit;
    if (log_scale.w > 0.0) {
        float shrink = filter_shrink(filter_ratio(log_scale));
        // If no filtered opacity can exceed the largest, there is no limit.
        limit = shrink > max_opacity ? -log(shrink / max_opacity - 1.0) : logit;
    }
    parameters[at].w = min(logit, limit);
    if (packed_moments == 1) {
        moments_1[at].yw &= 0xFFFFu;
    } else {
        moments_1[at].w = 0;
        moments_2[at].w = 0;
    }
}
