// Gradients of all parameters of all Gaussians in the layout of the parameters; zero for Gaussians that are not visible. For
// applications that read gradients. Training does not run it, because adam.comp computes the same values on the fly.
//
// invocation: one Gaussian
// in: parameters (PerGaussian planes, for the viewing direction), visible_index, gradients (PerVisible planes)
//     with a rolling shutter the camera block
// out: parameter_gradients (PerGaussian planes as in parameters), mean2d_gradients[Gaussian] (px)
// shared: none; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_control_flow_attributes : require
#extension GL_GOOGLE_include_directive : require

#include "constants.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(constant_id = 2) const uint SH_DEGREE = 3;
layout(constant_id = 3) const bool SH_LOOPS = false;
#ifdef LENSES
layout(constant_id = 4) const uint PROJECTION = PROJECTION_BROWN;
#endif
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) readonly buffer Parameters { vec4 parameters[]; };
layout(set = 0, binding = 1, scalar) readonly buffer VisibleIndex { uint visible_index[]; };
layout(set = 0, binding = 2, scalar) readonly buffer Gradients { vec4 gradients[]; };
layout(set = 0, binding = 3, scalar) writeonly buffer ParameterGradients { vec4 parameter_gradients[]; };
layout(set = 0, binding = 4, scalar) writeonly buffer Mean2dGradients { vec2 mean2d_gradients[]; };

layout(push_constant, scalar) uniform Push {
    vec3 camera_position;
    uint first;
    uint count;
    uint gradient_stride;
    uint chunk_gaussians;
    // Number of planes of the stored degree, which may exceed the active one.
    uint planes;
#include "shutter_push.glsl"
};

#ifdef LENSES
#include "camera_block.glsl"
#include "shutter_position.glsl"
#else
#define POSITION_SEEING(WORLD) camera_position
#endif
#include "dispatch.glsl"
#include "planes.glsl"
#include "sh.glsl"
#include "sh_gradient.glsl"

void expand_group(uint group, uint index, vec3 direction, vec3 d_color, bool seen) {
    vec4 basis = sh_basis_group(group, direction);
    [[unroll]] for (uint k = 0; k < 3; ++k) {
        uint plane = 3 * group + k;
        vec4 g = plane < SH_PLANES ? sh_plane_gradient(k, basis, d_color) : vec4(0.0);
        if (PLANE_SH + plane < planes) {
            parameter_gradients[plane_at(PLANE_SH + plane, index, chunk_gaussians)] = seen ? g : vec4(0.0);
        }
    }
}

void main() {
    uint index = linear_invocation();
    if (index >= count) {
        return;
    }
    uint visible = visible_index[first + index];
    bool seen = visible != NOT_VISIBLE;
    uint row = seen ? visible : 0;
    vec4 mean_opacity = gradients[GRADIENT_MEAN_OPACITY * gradient_stride + row];
    vec4 quat = gradients[GRADIENT_QUAT * gradient_stride + row];
    vec4 log_scale_x = gradients[GRADIENT_LOG_SCALE * gradient_stride + row];
    vec4 color_y = gradients[GRADIENT_COLOR * gradient_stride + row];
    vec3 mean = parameters[plane_at(PLANE_MEAN_OPACITY, index, chunk_gaussians)].xyz;
    vec3 direction = normalize(mean - POSITION_SEEING(mean));

    parameter_gradients[plane_at(PLANE_MEAN_OPACITY, index, chunk_gaussians)] = seen ? mean_opacity : vec4(0.0);
    parameter_gradients[plane_at(PLANE_QUAT, index, chunk_gaussians)] = seen ? quat : vec4(0.0);
    parameter_gradients[plane_at(PLANE_LOG_SCALE, index, chunk_gaussians)] = seen ? vec4(log_scale_x.xyz, 0.0) : vec4(0.0);
    mean2d_gradients[first + index] = seen ? vec2(log_scale_x.w, color_y.w) : vec2(0.0);
#define EXPAND_GROUP(GROUP) expand_group(GROUP, index, direction, color_y.xyz, seen)
    EACH_SH_GROUP(SH_PLANES_3 / 3, EXPAND_GROUP)
}
