// Alignment of Gaussians with the picture's surface, by the pixel at a Gaussian's mean: its shortest axis n turns to the surface's
// normal N and shrinks. Adds the gradient of
//   share (turn (1 - (n . N)^2) + flatten s)
// with s the shortest axis in pixels. N, `share` and the z in s are constants in gradients. The share is the area that the Gaussian
// covers, px^2, times its opacity and exp(-e^2 / SURFACE_REACH^2), where e = z d - 1 is the relative distance from the surface of
// inverse depth d, so that Gaussians behind the surface stay as they are.
//
// invocation: one visible Gaussian of the bound parameter range
// in: parameters (PerGaussian planes), visible_ranges, visible_list, mean2d_extent, conic_opacity; PerPixel: surface_depths
//     (surface_depth.comp)
// in/out: parameter_gradients (PerGaussian geometry planes)
// shared: none; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require

#include "constants.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) readonly buffer Parameters { vec4 parameters[]; };
layout(set = 0, binding = 1, scalar) readonly buffer VisibleRanges { uvec4 visible_ranges[]; };
layout(set = 0, binding = 2, scalar) readonly buffer VisibleList { uint visible_list[]; };
layout(set = 0, binding = 3, scalar) readonly buffer Mean2dExtent { vec4 mean2d_extent[]; };
layout(set = 0, binding = 4, scalar) readonly buffer ConicOpacity { vec4 conic_opacity[]; };
layout(set = 0, binding = 5, scalar) readonly buffer SurfaceDepths { float surface_depths[]; };
layout(set = 0, binding = 6, scalar) buffer ParameterGradients { vec4 parameter_gradients[]; };

layout(push_constant, scalar) uniform Push {
    // First Gaussian of the bound parameter range.
    uint first;
    uint splat_stride;
    // Distance of the pixels whose differences give the normal.
    int stride_px;
    // Weights, divided by the number of pixels.
    float turn;
    float flatten;
};

#include "camera_block.glsl"
#include "camera.glsl"
#include "dispatch.glsl"
#include "finite.glsl"
#include "planes.glsl"
#include "rotation.glsl"
#include "quaternion_gradient.glsl"
#include "splat_record.glsl"
#include "surface_loss.glsl"

float depth_at(ivec2 at) {
    return surface_depths[at.y * image_width + at.x];
}

void main() {
    // A workgroup has the size of a culling block.
    uvec4 visible_range = visible_ranges[2 * (first / WORKGROUP_SIZE) + 1];
    uint visible = visible_range.x + linear_invocation();
    if (visible >= visible_range.y) {
        return;
    }
    vec2 mean2d_px = mean2d_extent[splat_at(visible, SPLAT_MEAN2D_EXTENT)].xy;
    vec2 size = vec2(image_width, image_height);
    if (any(lessThan(mean2d_px, vec2(stride_px))) || any(greaterThan(mean2d_px, size - float(stride_px + 1)))) {
        return;
    }
    ivec2 at = ivec2(mean2d_px + 0.5);
    float here = depth_at(at);
    vec2 x = vec2(depth_at(at - ivec2(stride_px, 0)), depth_at(at + ivec2(stride_px, 0)));
    vec2 y = vec2(depth_at(at - ivec2(0, stride_px)), depth_at(at + ivec2(0, stride_px)));
    if (min(here, min(min(x.x, x.y), min(y.x, y.y))) <= 0.0) {
        return;
    }
    // A plane N . X = c has the inverse depth (N . (X / z)) / c.
    vec2 slope = vec2(x.y - x.x, y.y - y.x) / float(2 * stride_px);
    vec3 normal = normalize(vec3(slope * focal_px, here - dot(vec2(at) - center_px, slope)));

    uint index = visible_list[visible] - first;
    uint quat_at = geometry_at(PLANE_QUAT, index);
    uint scale_at = geometry_at(PLANE_LOG_SCALE, index);
    float z = dot(camera_row_z, parameters[geometry_at(PLANE_MEAN_OPACITY, index)].xyz) + camera_translation.z;
    float e = (z * (here + dot(slope, mean2d_px - vec2(at))) - 1.0) / SURFACE_REACH;
    vec4 conic = conic_opacity[splat_at(visible, SPLAT_CONIC_OPACITY)];
    // Dropout may raise opacities above 1.
    float share = 6.2831853 * inversesqrt(conic.x * conic.z - conic.y * conic.y) * min(conic.w, 1.0) * exp(-e * e);

    vec4 quat = parameters[quat_at];
    float norm = length(quat);
    float inverse_norm = norm > QUAT_NORM_MIN ? 1.0 / norm : 0.0;
    vec4 unit = quat * inverse_norm;
    vec3 log_scale = parameters[scale_at].xyz;
    uint shortest = log_scale.y < log_scale.x ? 1 : 0;
    shortest = log_scale.z < log_scale[shortest] ? 2 : shortest;
    vec3 world_normal = from_camera(normal);
    mat3 d_axes = mat3(0.0);
    d_axes[shortest] = -2.0 * turn * dot(rotation_of(unit)[shortest], world_normal) * world_normal;
    vec4 d_quat = share * quaternion_backward(unit, inverse_norm, d_axes);
    float d_log_scale = share * flatten * exp(log_scale[shortest]) * focal_px.x / z;
    // A degenerate conic must not reach the optimiser.
    if (!finite(vec4(share, d_log_scale, 0.0, 0.0))) {
        return;
    }
    parameter_gradients[quat_at] += d_quat;
    parameter_gradients[scale_at][shortest] += d_log_scale;
}
