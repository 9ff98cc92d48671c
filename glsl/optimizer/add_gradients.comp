// Adds the gradients of a view to the sums since the optimiser's last step (Improved-GS, multi-step update). SH gradients
// depend on the viewing direction, so the sums have a value per parameter, in the layout of the parameters. A Gaussian whose
// gradient is not finite adds nothing, and is counted. If the frame overflowed, nothing changes.
//
// invocation: one Gaussian
// in: parameters (PerGaussian planes, for the viewing direction), visible_index, gradients (PerVisible planes), camera block
// in/out: sums (PerGaussian planes), bound a second time for reads; written whole if `starts` is set
//     state[STATE_NON_FINITE] counts the skipped Gaussians
// shared: none; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_control_flow_attributes : require
#extension GL_GOOGLE_include_directive : require

#include "constants.glsl"
#include "buffers.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(constant_id = 2) const uint SH_DEGREE = 3;
layout(constant_id = 4) const bool PARAMETER_GRADIENTS = false;
// Same as in adam.comp.
layout(constant_id = 7) const bool MOVED_CAMERA = false;
layout(constant_id = 8) const bool SH_LOOPS = false;
layout(local_size_x_id = 0) in;

ALIASED VEC4_WRITES(0, Sums, sums);
VEC4_READS(1, Parameters, parameters);
UINT_READS(2, VisibleIndex, visible_index);
VEC4_READS(3, Gradients, gradients);
layout(set = 0, binding = 4, scalar) buffer State { uint state[]; };
// Same memory as the first binding. Each invocation reads its own elements before it writes them.
ALIASED VEC4_READS(5, OldSums, old_sums);
VEC4_READS(6, ParameterGradients, parameter_gradients);

layout(push_constant, scalar) uniform Push {
    vec3 camera_position;
    uint first;
    uint count;
    uint chunk_gaussians;
    uint gradient_stride;
    // Number of planes of the stored degree, which may exceed the active one.
    uint planes;
    // Nonzero if these gradients are the first since the last step.
    uint starts;
};

#include "camera_block.glsl"
#include "dispatch.glsl"
#include "finite.glsl"
#include "moved_camera.glsl"
#include "planes.glsl"
#include "sh.glsl"
#include "sh_gradient.glsl"

void add(uint at, vec4 g) {
    vec4 sum = starts != 0 ? g : VEC4_AT(old_sums, at) + g;
    VEC4_PUT(sums, at, sum);
}

void add_group(uint group, uint index, vec3 direction, vec3 d_color) {
    vec4 basis = sh_basis_group(group, direction);
    [[unroll]] for (uint k = 0; k < 3; ++k) {
        uint plane = 3 * group + k;
        uint at = plane_at(PLANE_SH + plane, index, chunk_gaussians);
        if (plane < SH_PLANES) {
            add(at, sh_plane_gradient(k, basis, d_color));
        } else if (starts != 0 && PLANE_SH + plane < planes) {
            // A later view may have a higher degree.
            VEC4_PUT(sums, at, vec4(0.0));
        }
    }
}

void main() {
    uint index = linear_invocation();
    if (index >= count || state[STATE_OVERFLOW] != 0) {
        return;
    }
    uint visible = UINT_AT(visible_index, first + index);
    bool seen = visible != NOT_VISIBLE;
    if (!seen && !PARAMETER_GRADIENTS && starts == 0) {
        return;
    }
    uint row = seen ? visible : 0;
    vec4 d_mean_opacity = VEC4_AT(gradients, GRADIENT_MEAN_OPACITY * gradient_stride + row);
    vec4 d_quat = VEC4_AT(gradients, GRADIENT_QUAT * gradient_stride + row);
    vec4 d_log_scale = vec4(VEC4_AT(gradients, GRADIENT_LOG_SCALE * gradient_stride + row).xyz, 0.0);
    vec4 d_color = vec4(VEC4_AT(gradients, GRADIENT_COLOR * gradient_stride + row).xyz, 0.0);
    d_mean_opacity = seen ? d_mean_opacity : vec4(0.0);
    d_quat = seen ? d_quat : vec4(0.0);
    d_log_scale = seen ? d_log_scale : vec4(0.0);
    d_color = seen ? d_color : vec4(0.0);
    if (PARAMETER_GRADIENTS) {
        d_mean_opacity += VEC4_AT(parameter_gradients, geometry_at(PLANE_MEAN_OPACITY, index));
        d_quat += VEC4_AT(parameter_gradients, geometry_at(PLANE_QUAT, index));
        d_log_scale.xyz += VEC4_AT(parameter_gradients, geometry_at(PLANE_LOG_SCALE, index)).xyz;
    }
    bool counts = finite(d_mean_opacity) && finite(d_quat) && finite(d_log_scale) && finite(d_color);
    if (!counts) {
        atomicAdd(state[STATE_NON_FINITE], 1);
        if (starts == 0) {
            return;
        }
        d_mean_opacity = d_quat = d_log_scale = d_color = vec4(0.0);
    }
    vec3 mean = VEC4_AT(parameters, plane_at(PLANE_MEAN_OPACITY, index, chunk_gaussians)).xyz;
    // Same as in adam.comp: out of view there may be no direction.
    vec3 direction = seen && counts ? normalize(mean - position_of_camera()) : vec3(0.0);

    add(plane_at(PLANE_MEAN_OPACITY, index, chunk_gaussians), d_mean_opacity);
    add(plane_at(PLANE_QUAT, index, chunk_gaussians), d_quat);
    add(plane_at(PLANE_LOG_SCALE, index, chunk_gaussians), d_log_scale);
#define ADD_GROUP(GROUP) add_group(GROUP, index, direction, d_color.xyz)
    EACH_SH_GROUP(SH_PLANES_3 / 3, ADD_GROUP)
}
