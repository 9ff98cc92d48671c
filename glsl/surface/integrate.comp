// Adds a view's depths of surfaces and colours to the distance field (Curless and Levoy 1996).
//
//   s = depth - z at the pixel that shows the voxel; nothing changes for s < -truncation, behind the surface
//   d <- (W d + w min(s, truncation)) / (W + w), W <- W + w, with w = the square of the voxel's size in pixels, because errors
//   of depth grow with z. Colours likewise, from views with |s| <= truncation only.
//
// invocation: one voxel of a visible block
// in, PerPixel: surfaces (.w: depth, 0 for none), accumulated; visible_blocks; in/out, per voxel: distances, colors
// shared: none; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require

#define FIELD
#include "constants.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(local_size_x_id = 0) in;

// Place and index of each block.
layout(set = 0, binding = 0, scalar) readonly buffer VisibleBlocks { ivec4 visible_blocks[]; };
layout(set = 0, binding = 1, scalar) readonly buffer Surfaces { vec4 surfaces[]; };
layout(set = 0, binding = 2, scalar) readonly buffer Accumulated { vec4 accumulated[]; };
// See field.glsl.
layout(set = 0, binding = 3, scalar) buffer Distances { uvec2 distances[]; };
// Per voxel, as half floats: mean r, g, b, and the sum of their weights.
layout(set = 0, binding = 4, scalar) buffer Colors { uvec2 colors[]; };

layout(push_constant, scalar) uniform Push {
    vec3 row_x;
    vec3 row_y;
    vec3 row_z;
    vec3 translation;
    vec2 focal_px;
    // The first pixel's centre is at 0.5.
    vec2 center_px;
    uint image_width;
    uint image_height;
    // Number of voxels in the visible blocks.
    uint voxels;
    // World units.
    float voxel_size;
    float truncation;
    // Depths beyond it do not count.
    float max_depth;
};

#include "dispatch.glsl"

// Sums of weights grow up to this value. From then on a mean slowly forgets old views.
const float LARGEST_HALF = 65504.0;

void main() {
    uint invocation = linear_invocation();
    if (invocation >= voxels) {
        return;
    }
    ivec4 block = visible_blocks[invocation / FIELD_VOXELS];
    uint voxel = uint(block.w) * FIELD_VOXELS + invocation % FIELD_VOXELS;
    uvec3 place = uvec3(voxel, voxel / FIELD_SIDE, voxel / (FIELD_SIDE * FIELD_SIDE)) % FIELD_SIDE;
    vec3 point = voxel_size * vec3(block.xyz * int(FIELD_SIDE) + ivec3(place));
    vec3 at = vec3(dot(row_x, point), dot(row_y, point), dot(row_z, point)) + translation;
    vec2 pixel = focal_px * at.xy / at.z + center_px;
    vec2 size = vec2(image_width, image_height);
    if (!(at.z > NEAR_PLANE && all(greaterThanEqual(pixel, vec2(0.0))) && all(lessThan(pixel, size)))) {
        return;
    }
    uint index = uint(pixel.y) * image_width + uint(pixel.x);
    float depth = surfaces[index].w;
    float ahead = depth - at.z;
    if (!(depth > 0.0 && depth < max_depth && ahead >= -truncation)) {
        return;
    }
    float pixels = voxel_size * focal_px.x / at.z;
    float weight = min(pixels * pixels, LARGEST_HALF);
    uvec2 before = distances[voxel];
    uint views = before.y >> 16;
    float mean_distance = uintBitsToFloat(before.x);
    float sum = min(unpackHalf2x16(before.y).x + weight, LARGEST_HALF);
    mean_distance += weight / sum * (min(ahead, truncation) - mean_distance);
    distances[voxel] = uvec2(floatBitsToUint(mean_distance), packHalf2x16(vec2(sum, 0.0)) | min(views + 1, 0xFFFFu) << 16);
    if (ahead <= truncation) {
        vec4 shown = accumulated[index];
        vec3 color = clamp(shown.xyz / (1.0 - shown.w), 0.0, 1.0);
        uvec2 words = colors[voxel];
        vec4 mean = vec4(unpackHalf2x16(words.x), unpackHalf2x16(words.y));
        float color_sum = min(mean.w + weight, LARGEST_HALF);
        mean = vec4(mean.xyz + weight / color_sum * (color - mean.xyz), color_sum);
        colors[voxel] = uvec2(packHalf2x16(mean.xy), packHalf2x16(mean.zw));
    }
}
