// Blended picture in the layout of hosts: row by row, one vec4 per pixel, composited on the background.
//
// invocation: one pixel
// in: rendered, in the layout of blending for the loss: with STRIPS three planes in strips (strips.glsl), composited; otherwise
//     per pixel the colour without background and the transmittance
// out: rows[y * image_width + x] = (r, g, b, 0)
// shared: none; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(constant_id = 2) const bool STRIPS = false;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) readonly buffer Rendered { float rendered[]; };
layout(set = 0, binding = 1, scalar) writeonly buffer Rows { vec4 rows[]; };

layout(push_constant, scalar) uniform Push {
    uint image_width;
    uint image_height;
    vec3 background;
};

#include "constants.glsl"
#include "dispatch.glsl"
#include "strips.glsl"

void main() {
    uint index = linear_invocation();
    if (index >= image_width * image_height) {
        return;
    }
    uvec2 at = uvec2(index % image_width, index / image_width);
    vec3 color;
    if (STRIPS) {
        for (uint plane = 0; plane < 3; ++plane) {
            color[plane] = rendered[strip_value(plane, at)];
        }
    } else {
        color = vec3(rendered[4 * index], rendered[4 * index + 1], rendered[4 * index + 2]);
        color += rendered[4 * index + 3] * background;
    }
    rows[index] = vec4(color, 0.0);
}
