// Gradient through the exposure of a photograph (exposure.glsl), with g = dL/d(exposed picture) of each pixel:
//
//   dL/d(picture_k) = sum over c of E[k][c] g_c,  dL/dE[k][c] = sum over pixels of picture_k g_c,  dL/dE[c][3] = sum of g_c
//
// or with LENS through a lens (lens_effects.glsl), with t = V x for each channel:
//
//   dL/dx = g y'(t) V,  dL/da_k = sum over pixels of g y'(t) x r^(2k),  dL/d(ln gamma) = sum over pixels of g dy/d(ln gamma)
//
// invocation: every (number of invocations)-th pixel; the number of workgroups is TERM_PARTIALS
// in: rendered, with LENS perhaps exposed; matrices
// in/out: image_gradient, from g to dL/d(picture): with STRIPS planes in strips (strips.glsl), otherwise per pixel a vec4
//     whose fourth component stays
// out: partials[3 * workgroup + k] = row k of the workgroup's part of the matrix's gradient
// shared: three vec4 per subgroup; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require

#include "constants.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(constant_id = 1) const uint SUBGROUP_SIZE = 32;
layout(constant_id = 2) const bool STRIPS = false;
layout(constant_id = 3) const bool LENS = false;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) readonly buffer Rendered { float rendered[]; };
layout(set = 0, binding = 1, scalar) readonly buffer Matrices { vec4 matrices[]; };
layout(set = 0, binding = 2, scalar) buffer ImageGradient { float image_gradient[]; };
layout(set = 0, binding = 3, scalar) writeonly buffer Partials { vec4 partials[]; };

layout(push_constant, scalar) uniform Push {
    uint image_width;
    uint image_height;
    vec3 background;
    uint matrix;
    // Only used with LENS: the principal point, with the first pixel's centre at 0, and 1 / half of the picture's diagonal, squared.
    vec2 center_px;
    float inverse_square;
};

#include "strips.glsl"
#include "exposure.glsl"
#include "exposure_sums.glsl"
#include "lens_effects.glsl"

void main() {
    vec4 row[3] = vec4[3](matrices[3 * matrix], matrices[3 * matrix + 1], matrices[3 * matrix + 2]);
    vec4 sums[3] = vec4[3](vec4(0.0), vec4(0.0), vec4(0.0));
    uint stride = TERM_PARTIALS * WORKGROUP_SIZE;
    uint first = gl_WorkGroupID.x * WORKGROUP_SIZE + gl_LocalInvocationID.x;
    for (uint index = first; index < image_width * image_height; index += stride) {
        uvec2 at = uvec2(index % image_width, index / image_width);
        vec3 picture = rendered_color(index, at);
        float r2 = square_of_radius(at);
        uint place[3];
        vec3 g;
        for (uint k = 0; k < 3; ++k) {
            place[k] = STRIPS ? strip_value(k, at) : 4 * index + k;
            g[k] = image_gradient[place[k]];
        }
        for (uint k = 0; k < 3; ++k) {
            if (LENS) {
                float shade = vignetting(row[k], r2);
                vec3 y = response(picture[k] * shade, exp(row[k].w));
                float by_x = g[k] * y.y;
                vec3 powers = r2 * vec3(1.0, r2, r2 * r2);
                sums[k] += vec4(by_x * picture[k] * powers, g[k] * y.z);
                image_gradient[place[k]] = by_x * shade;
            } else {
                sums[k] += vec4(picture[k] * g, g[k]);
                image_gradient[place[k]] = dot(row[k].xyz, g);
            }
        }
    }
    add_over_workgroup(sums);
    if (gl_LocalInvocationID.x == 0) {
        for (uint k = 0; k < 3; ++k) {
            partials[3 * gl_WorkGroupID.x + k] = sums[k];
        }
    }
}
