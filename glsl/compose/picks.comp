// Writes the pick of each pixel into a host's storage image: the Gaussian of the largest weight, by its index in its own scene,
// and the scene.
//
// invocation: one pixel
// in, PerPixel: picks (1 + place in the tile's list, or 0; bits of the weight); tile_ranges, sorted_visible; PerVisible:
//     visible_list, color_inverse_depth; scene_firsts: index of each scene's first Gaussian among all, in rising order
// out: target (rgba32ui): Gaussian, scene, bits of its depth z in world units, bits of its weight; if nothing is blended,
//     NOT_PICKED twice and 0 twice
// shared: none; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require

#include "constants.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) readonly buffer Picks { uvec2 picks[]; };
layout(set = 0, binding = 1, scalar) readonly buffer TileRanges { uvec2 tile_ranges[]; };
layout(set = 0, binding = 2, scalar) readonly buffer SortedVisible { uint sorted_visible[]; };
layout(set = 0, binding = 3, scalar) readonly buffer VisibleList { uint visible_list[]; };
layout(set = 0, binding = 4, scalar) readonly buffer ColorInverseDepth { vec4 color_inverse_depth[]; };
layout(set = 0, binding = 5, scalar) readonly buffer SceneFirsts { uint scene_firsts[]; };
layout(set = 0, binding = 16, rgba32ui) writeonly uniform uimage2D target;

layout(push_constant, scalar) uniform Push {
    uint image_width;
    uint image_height;
    // Texel of the target that receives pixel (0, 0).
    uint offset_x;
    uint offset_y;
    uint tiles_per_row;
    uint splat_stride;
    uint scenes;
};

#include "dispatch.glsl"
#include "splat_record.glsl"

// Last scene that begins at or before a Gaussian. Scenes that are not drawn begin where the next one does.
uint scene_of(uint gaussian) {
    uint low = 0;
    uint end = scenes;
    while (end - low > 1) {
        uint middle = (low + end) / 2;
        bool before = scene_firsts[middle] <= gaussian;
        low = before ? middle : low;
        end = before ? end : middle;
    }
    return low;
}

void main() {
    uint index = linear_invocation();
    if (index >= image_width * image_height) {
        return;
    }
    uvec2 pixel = uvec2(index % image_width, index / image_width);
    uvec2 pick = picks[index];
    uvec4 texel = uvec4(NOT_PICKED, NOT_PICKED, 0, 0);
    if (pick.x > 0) {
        uint tile = pixel.y / TILE_SIZE * tiles_per_row + pixel.x / TILE_SIZE;
        uint visible = sorted_visible[tile_ranges[tile].x + pick.x - 1];
        uint gaussian = visible_list[visible];
        uint scene = scene_of(gaussian);
        float z = 1.0 / color_inverse_depth[splat_at(visible, SPLAT_COLOR_INVERSE_DEPTH)].w;
        texel = uvec4(gaussian - scene_firsts[scene], scene, floatBitsToUint(z), pick.y);
    }
    imageStore(target, ivec2(pixel + uvec2(offset_x, offset_y)), texel);
}
