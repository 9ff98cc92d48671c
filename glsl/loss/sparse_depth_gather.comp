// Converts dL/dZ at sparse points (sparse_depth.comp) to the gradient of the sampled pixels. The points of each pixel have a
// fixed order.
//
// A pixel's expected depth is Z = N / A, N = sum(w z), A = sum(w) = 1 - T, so dL = g / A (dN - Z dA) with g = dL/dZ. That is
// the gradient g / A of the depth N + Z T, with Z as the background. The backward pass of the blending starts from the
// picture's depth, so Z replaces N there.
//
// invocation: one sampled pixel
// in: points[point] = (x, y, px; 1/z), sample_gradients[point], PerPixel: accumulated (.w = T); pixels[place] = (index, end of its
//     entries, which begin where those of the pixel before end), entries[] = 4 point + corner
// in/out, PerPixel: depth_sums, N becomes Z; image_gradient, dL/d(depth): with STRIPS the fourth plane in strips (strips.glsl),
//     otherwise the fourth component of each pixel
// shared: none; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require

#include "constants.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(constant_id = 2) const bool STRIPS = false;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) readonly buffer Points { vec3 points[]; };
layout(set = 0, binding = 1, scalar) readonly buffer Pixels { uvec2 pixels[]; };
layout(set = 0, binding = 2, scalar) readonly buffer Entries { uint entries[]; };
layout(set = 0, binding = 3, scalar) readonly buffer SampleGradients { float sample_gradients[]; };
layout(set = 0, binding = 4, scalar) readonly buffer Accumulated { vec4 accumulated[]; };
layout(set = 0, binding = 5, scalar) buffer DepthSums { float depth_sums[]; };
layout(set = 0, binding = 6, scalar) buffer ImageGradient { float image_gradient[]; };

layout(push_constant, scalar) uniform Push {
    uint image_width;
    uint image_height;
    // Number of sampled pixels.
    uint count;
};

#include "dispatch.glsl"
#include "strips.glsl"
#include "depth_points.glsl"

void main() {
    uint place = linear_invocation();
    if (place >= count) {
        return;
    }
    uint index = pixels[place].x;
    uint begin = place == 0 ? 0 : pixels[place - 1].y;
    float gradient = 0.0;
    for (uint entry = begin; entry < pixels[place].y; ++entry) {
        uint point = entries[entry] / 4;
        gradient += corner_weight(points[point].xy, entries[entry] % 4) * sample_gradients[point];
    }
    float coverage = covered(accumulated[index].w);
    uvec2 at = uvec2(index % image_width, index / image_width);
    // If nothing is blended, there is no gradient.
    image_gradient[STRIPS ? strip_value(3, at) : 4 * index + 3] += coverage > COVERAGE_MIN ? gradient / coverage : 0.0;
    depth_sums[index] /= coverage;
}
