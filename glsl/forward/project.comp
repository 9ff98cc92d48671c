// Screen-space attributes of the visible Gaussians: mean, conic, extent, tiles, depth, and colour from
// spherical harmonics (paper, section 4; reference preprocessCUDA and computeColorFromSH).
//
// invocation: one visible Gaussian; those outside the bound range of parameters leave at once
// in: parameters (PerGaussian planes), visible_list; out, PerVisible: mean2d_extent (x, y, half extents, px),
//     conic_opacity (A, B, C, opacity), color_inverse_depth (r, g, b, 1/z), depth_keys (bits of z),
//     footprints (x0 | x1 << 16, y0 | y1 << 16 in tiles, radius in px, 0)
// shared: none; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require

#include "constants.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(constant_id = 2) const uint SH_DEGREE = 3;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) readonly buffer Parameters { vec4 parameters[]; };
layout(set = 0, binding = 1, scalar) readonly buffer State { uint state[]; };
layout(set = 0, binding = 2, scalar) readonly buffer VisibleList { uint visible_list[]; };
layout(set = 0, binding = 3, scalar) writeonly buffer Mean2dExtent { vec4 mean2d_extent[]; };
layout(set = 0, binding = 4, scalar) writeonly buffer ConicOpacity { vec4 conic_opacity[]; };
layout(set = 0, binding = 5, scalar) writeonly buffer ColorInverseDepth { vec4 color_inverse_depth[]; };
layout(set = 0, binding = 6, scalar) writeonly buffer DepthKeys { uint depth_keys[]; };
layout(set = 0, binding = 7, scalar) writeonly buffer Footprints { uvec4 footprints[]; };

#include "camera_push.glsl"
#include "dispatch.glsl"
#include "projection.glsl"
#include "sh.glsl"
#include "sh_planes.glsl"

void main() {
    uint visible = linear_invocation();
    bool exists = visible < state[STATE_VISIBLE];
    uint index = visible_list[exists ? visible : 0] - first;
    if (!exists || index >= count) {
        return;
    }
    vec4 mean_opacity = parameters[PLANE_MEAN_OPACITY * stride + index];
    vec4 quat = parameters[PLANE_QUAT * stride + index];
    vec4 log_scale = parameters[PLANE_LOG_SCALE * stride + index];
    Projection p = project_gaussian(mean_opacity.xyz, quat, log_scale.xyz);
    Footprint f = footprint_of(p, mean_opacity.w);

    vec3 direction = normalize(mean_opacity.xyz - camera_position());
    float basis[16];
    sh_basis(direction, basis);
    vec3 sh[16];
    sh_coefficients(index, sh);
    vec3 color = vec3(0.5);
    for (uint k = 0; k < 16; ++k) {
        color += basis[k] * sh[k];
    }

    // A coefficient that is not finite must not spread to the pixels.
    bool valid = is_finite(color.x) && is_finite(color.y) && is_finite(color.z);
    color = valid ? color : vec3(0.0);

    mean2d_extent[visible] = vec4(f.mean2d_px, f.half_extent_px);
    conic_opacity[visible] = vec4(vec3(p.cov2d.z, -p.cov2d.y, p.cov2d.x) / p.det, f.opacity);
    color_inverse_depth[visible] = vec4(max(color, vec3(0.0)), 1.0 / p.mean_camera.z);
    depth_keys[visible] = floatBitsToUint(p.mean_camera.z);
    footprints[visible] = uvec4(f.tiles.x | f.tiles.y << 16, f.tiles.z | f.tiles.w << 16, f.radius_px, 0);
}
