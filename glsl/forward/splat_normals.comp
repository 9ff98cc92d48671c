// Normals of the visible Gaussians: each one's shortest axis, turned towards the camera.
//
//   n = R R(q) e, where e is the axis of the smallest scale (the first of equal ones), and n . v <= 0 for the direction v from
//   the camera to the mean, or with PARALLEL the camera's axis
//
// A quaternion of zeros is no rotation. A scene's scale does not change the normals' length of 1.
//
// invocation: one visible Gaussian of the bound parameter range
// in: parameters (PerGaussian planes), visible_list, visible_ranges; out, PerVisible: normals, in the camera's frame; .w is 0
// shared: none; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require

#include "constants.glsl"
#include "buffers.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
// True for parallel rays: the projection is orthographic.
layout(constant_id = 2) const bool PARALLEL = false;
layout(local_size_x_id = 0) in;

VEC4_READS(0, Parameters, parameters);
UVEC4_READS(1, VisibleRanges, visible_ranges);
UINT_READS(2, VisibleList, visible_list);
VEC4_WRITES(3, Normals, normals);

layout(push_constant, scalar) uniform Push {
    // First Gaussian of the bound parameter range.
    uint first;
};

#include "camera_block.glsl"
#include "camera.glsl"
#include "dispatch.glsl"
#include "planes.glsl"
#include "rotation.glsl"

void main() {
    // A workgroup has the size of a culling block.
    uvec4 visible_range = UVEC4_AT(visible_ranges, 2 * (first / WORKGROUP_SIZE) + 1);
    uint visible = visible_range.x + linear_invocation();
    if (visible >= visible_range.y) {
        return;
    }
    uint index = UINT_AT(visible_list, visible) - first;
    vec3 mean = VEC4_AT(parameters, geometry_at(PLANE_MEAN_OPACITY, index)).xyz;
    vec4 quat = VEC4_AT(parameters, geometry_at(PLANE_QUAT, index));
    vec3 log_scale = VEC4_AT(parameters, geometry_at(PLANE_LOG_SCALE, index)).xyz;
    float norm = length(quat);
    mat3 axes = rotation_of(quat * (norm > QUAT_NORM_MIN ? 1.0 / norm : 0.0));
    vec3 axis = log_scale.y < log_scale.x ? axes[1] : axes[0];
    axis = log_scale.z < min(log_scale.x, log_scale.y) ? axes[2] : axis;
    vec3 normal = to_camera(axis) * sqrt(inverse_scale_squared);
    vec3 view = PARALLEL ? vec3(0.0, 0.0, 1.0) : to_camera(mean) + camera_translation;
    VEC4_PUT(normals, visible, vec4(dot(normal, view) > 0.0 ? -normal : normal, 0.0));
}
