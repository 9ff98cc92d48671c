// Normals of the visible Gaussians: each one's shortest axis, turned towards the camera. Also the slopes of their depths
// over the picture, because a ray meets a Gaussian where its density along the ray is largest, not at the depth of its mean.
//
//   n = R R(q) e, where e is the axis of the smallest scale (the first of equal ones), and n . v <= 0 for the direction v from
//   the camera to the mean, or for parallel rays the camera's axis
//   depth(p) = z + s . (p - mean2d), s = cov2d^-1 cov(p, z): the mean of z given p, to first order (Zhang et al. 2024, RaDe-GS)
//
// A quaternion of zeros is no rotation. A scene's scale does not change the normals' length of 1. Lenses have slopes of 0.
//
// invocation: one visible Gaussian of the bound parameter range
// in: parameters (PerGaussian planes), visible_list, visible_ranges
// out, PerVisible: splat_surfaces: normal in the camera's frame; slope, world units per px, as two half floats
// shared: none; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require

#include "constants.glsl"
#include "buffers.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
// See pinhole.glsl.
layout(constant_id = 2) const uint PROJECTION = PROJECTION_PERSPECTIVE;
layout(local_size_x_id = 0) in;

VEC4_READS(0, Parameters, parameters);
UVEC4_READS(1, VisibleRanges, visible_ranges);
UINT_READS(2, VisibleList, visible_list);
VEC4_WRITES(3, SplatSurfaces, splat_surfaces);

layout(push_constant, scalar) uniform Push {
    // First Gaussian of the bound parameter range.
    uint first;
};

#include "camera_block.glsl"
#include "camera.glsl"
#include "pinhole.glsl"
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
    axes = mat3(to_camera(axes[0]), to_camera(axes[1]), to_camera(axes[2]));
    vec3 at = to_camera(mean) + camera_translation;
    vec3 normal = log_scale.y < log_scale.x ? axes[1] : axes[0];
    normal = log_scale.z < min(log_scale.x, log_scale.y) ? axes[2] : normal;
    normal *= sqrt(inverse_scale_squared);
    bool away = dot(normal, PROJECTION == PROJECTION_ORTHOGRAPHIC ? vec3(0.0, 0.0, 1.0) : at) > 0.0;
    vec3 row_x, row_y;
    jacobian_rows(jacobian_at(PROJECTION, at), axes, row_x, row_y);
    vec3 scale = exp(log_scale) * shape_scale;
    row_x *= scale;
    row_y *= scale;
    vec3 row_z = vec3(axes[0].z, axes[1].z, axes[2].z) * scale;
    float xx = dot(row_x, row_x), xy = dot(row_x, row_y), yy = dot(row_y, row_y);
    float xz = dot(row_x, row_z), yz = dot(row_y, row_z);
    // The determinant as in project_gaussian.glsl.
    vec3 minors = cross(row_x, row_y);
    float det = dot(minors, minors) + shape_dilation_px2 * (xx + yy + shape_dilation_px2);
    vec2 slope = vec2((yy + shape_dilation_px2) * xz - xy * yz, (xx + shape_dilation_px2) * yz - xy * xz) / det;
    slope = PROJECTION <= PROJECTION_ORTHOGRAPHIC ? clamp(slope, -65504.0, 65504.0) : vec2(0.0);
    VEC4_PUT(splat_surfaces, visible, vec4(away ? -normal : normal, uintBitsToFloat(packHalf2x16(slope))));
}
