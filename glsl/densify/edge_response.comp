// Edges of a photograph as integers: the response of the 3 x 3 Laplacian to the gray photograph (Improved-GS, edge-aware
// score).
//
//   gray = round((299 R + 587 G + 114 B) / 1000), halves to even;  response = clamp(8 centre - 8 neighbours, 0, 255)
//
// Outside the photograph gray is 0, so its border responds. Masked pixels have no response, nor do those at the cut sides of a
// part, because the pixels beyond are unknown.
//
// invocation: one pixel
// in: rows[y * image_width + x] = r | g << 8 | b << 16 | mask << 24
// out: responses[pixel]; ranges, see edges.glsl: the smallest and the largest response
// shared: none; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(constant_id = 1) const uint SUBGROUP_SIZE = 32;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) readonly buffer Rows { uint rows[]; };
layout(set = 0, binding = 1, scalar) writeonly buffer Responses { uint responses[]; };
layout(set = 0, binding = 2, scalar) buffer Ranges { uint ranges[]; };

layout(push_constant, scalar) uniform Push {
    uint image_width;
    uint image_height;
    // 0: every pixel counts.
    uint masked;
    // Bits of the cut sides: 1 left, 2 top, 4 right, 8 bottom.
    uint cut_sides;
};

#include "dispatch.glsl"
#include "edges.glsl"

int gray_at(ivec2 at) {
    bool inside = all(greaterThanEqual(at, ivec2(0))) && at.x < int(image_width) && at.y < int(image_height);
    uint texel = rows[inside ? uint(at.y) * image_width + uint(at.x) : 0];
    uint sum = 299 * (texel & 0xFFu) + 587 * (texel >> 8 & 0xFFu) + 114 * (texel >> 16 & 0xFFu);
    uint whole = sum / 1000;
    uint rest = sum % 1000;
    bool up = rest > 500 || (rest == 500 && whole % 2 == 1);
    return inside ? int(whole + (up ? 1 : 0)) : 0;
}

void main() {
    uint index = linear_invocation();
    bool exists = index < image_width * image_height;
    uint pixel = exists ? index : 0;
    ivec2 at = ivec2(pixel % image_width, pixel / image_width);
    int sum = 0;
    for (int dy = -1; dy <= 1; ++dy) {
        for (int dx = -1; dx <= 1; ++dx) {
            sum += gray_at(at + ivec2(dx, dy));
        }
    }
    bvec4 at_side = bvec4(at.x == 0, at.y == 0, at.x + 1 == int(image_width), at.y + 1 == int(image_height));
    bvec4 is_cut = notEqual(cut_sides & uvec4(1, 2, 4, 8), uvec4(0));
    bool at_cut = any(notEqual(uvec4(at_side) & uvec4(is_cut), uvec4(0)));
    bool counts = !at_cut && (masked == 0 || rows[pixel] >> 24 != 0);
    // The sum includes the centre.
    uint response = counts ? uint(clamp(9 * gray_at(at) - sum, 0, 255)) : 0;
    uint low = subgroupMax(exists ? ~response : 0);
    uint high = subgroupMax(exists ? response : 0);
    if (gl_SubgroupInvocationID == 0) {
        atomicMax(ranges[RANGE_EDGE_LOW], low);
        atomicMax(ranges[RANGE_EDGE_HIGH], high);
    }
    if (exists) {
        responses[index] = response;
    }
}
