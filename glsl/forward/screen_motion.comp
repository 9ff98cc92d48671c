// Motion of the visible Gaussians' means on the screen, from the previous frame to this one, by both cameras and poses.
//
//   m = p - p', where p is the projection of R mean + t (for a pinhole f xy / z + c), and p' is p in the previous frame
//
// Zero if the mean was not in front of the previous camera (z > NEAR_PLANE), or if a number is not finite. Limited to the
// picture's width and height, which lead out of the picture from any pixel. A Gaussian close to the previous camera's plane has
// a far p'; the limit keeps it from outweighing all others of a pixel. Both cameras use the same arithmetic, so a mean that has
// not moved has exactly the motion 0.
//
// invocation: one visible Gaussian of the bound parameter range
// in: parameters (PerGaussian planes), visible_list, visible_ranges; out, PerVisible: motions, px, y down
// shared: none; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require

#include "constants.glsl"
#include "buffers.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
// Projections of the current and of the previous camera: see pinhole.glsl.
layout(constant_id = 2) const uint PROJECTION = PROJECTION_PERSPECTIVE;
layout(constant_id = 3) const uint PREVIOUS_PROJECTION = PROJECTION_PERSPECTIVE;
layout(local_size_x_id = 0) in;

VEC4_READS(0, Parameters, parameters);
UVEC4_READS(1, VisibleRanges, visible_ranges);
UINT_READS(2, VisibleList, visible_list);
layout(set = 0, binding = 3, scalar) writeonly buffer Motions { vec2 motions[]; };

layout(push_constant, scalar) uniform Push {
    // First Gaussian of the bound parameter range.
    uint first;
    // Previous camera in the scene's previous axes, laid out like the camera block.
    vec3 previous_row_x;
    vec3 previous_row_y;
    vec3 previous_row_z;
    vec3 previous_translation;
    vec2 previous_focal_px;
    vec2 previous_center_px;
};

#include "camera_block.glsl"
#define PRECISE_SCREEN
#include "camera.glsl"
#include "pinhole.glsl"
#include "dispatch.glsl"
#include "finite.glsl"
#include "planes.glsl"

// Screen position (px) and depth of a point.
vec3 seen(vec3 point, mat3 rows, vec3 translation, vec2 focal, vec2 center, uint projection) {
    precise vec3 at = vec3(dot(rows[0], point), dot(rows[1], point), dot(rows[2], point)) + translation;
    return vec3(screen_of(projection, at, focal, center), at.z);
}

void main() {
    // A workgroup has the size of a culling block.
    uvec4 visible_range = UVEC4_AT(visible_ranges, 2 * (first / WORKGROUP_SIZE) + 1);
    uint visible = visible_range.x + linear_invocation();
    if (visible >= visible_range.y) {
        return;
    }
    uint index = UINT_AT(visible_list, visible) - first;
    vec3 mean = VEC4_AT(parameters, geometry_at(PLANE_MEAN_OPACITY, index)).xyz;
    mat3 rows = mat3(camera_row_x, camera_row_y, camera_row_z);
    mat3 previous_rows = mat3(previous_row_x, previous_row_y, previous_row_z);
    vec3 now = seen(mean, rows, camera_translation, focal_px, center_px, PROJECTION);
    vec3 before = seen(
        mean, previous_rows, previous_translation, previous_focal_px, previous_center_px, PREVIOUS_PROJECTION
    );
    vec2 motion = now.xy - before.xy;
    bool known = before.z > NEAR_PLANE && finite(vec4(motion, 0.0, 0.0));
    vec2 most = vec2(image_width, image_height);
    motions[visible] = known ? clamp(motion, -most, most) : vec2(0.0);
}
