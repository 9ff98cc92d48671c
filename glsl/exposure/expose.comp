// Rendered picture under the exposure of its photograph (exposure.glsl), or with LENS through the lens that took it
// (lens_effects.glsl). Nothing is clamped.
//
// invocation: one pixel, with STRIPS also of the rows that fill the last strip
// in: rendered, with LENS perhaps exposed; matrices
// out: exposed, laid out like `rendered`: with STRIPS three planes, 0 below the picture; otherwise (r, g, b, 0) per pixel
// shared: none; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(constant_id = 2) const bool STRIPS = false;
layout(constant_id = 3) const bool LENS = false;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) readonly buffer Rendered { float rendered[]; };
layout(set = 0, binding = 1, scalar) readonly buffer Matrices { vec4 matrices[]; };
layout(set = 0, binding = 2, scalar) writeonly buffer Exposed { float exposed[]; };

layout(push_constant, scalar) uniform Push {
    uint image_width;
    uint image_height;
    vec3 background;
    uint matrix;
    // Only used with LENS: the principal point, with the first pixel's centre at 0, and 1 / half of the picture's diagonal, squared.
    vec2 center_px;
    float inverse_square;
};

#include "constants.glsl"
#include "dispatch.glsl"
#include "strips.glsl"
#include "exposure.glsl"
#include "lens_effects.glsl"

void main() {
    uint index = linear_invocation();
    uint rows = STRIPS ? strips_of_image() * STRIP_ROWS : image_height;
    if (index >= image_width * rows) {
        return;
    }
    uvec2 at = uvec2(index % image_width, index / image_width);
    vec3 color = vec3(0.0);
    if (at.y < image_height) {
        vec3 picture = rendered_color(index, at);
        float r2 = square_of_radius(at);
        for (uint k = 0; k < 3; ++k) {
            vec4 row = matrices[3 * matrix + k];
            if (LENS) {
                color[k] = response(picture[k] * vignetting(row, r2), exp(row.w)).x;
            } else {
                color += picture[k] * row.xyz;
                color[k] += row.w;
            }
        }
    }
    if (STRIPS) {
        for (uint plane = 0; plane < 3; ++plane) {
            exposed[strip_value(plane, at)] = color[plane];
        }
    } else {
        for (uint k = 0; k < 4; ++k) {
            exposed[4 * index + k] = k < 3 ? color[k] : 0.0;
        }
    }
}
