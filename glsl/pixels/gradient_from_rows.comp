// Converts the gradient of a picture from the layout of hosts to that of the backward pass.
//
// invocation: one pixel
// in: rows[y * image_width + x] = dL/d(r, g, b, inverse depth)
// out, with ADD in/out: image_gradient, with STRIPS as `planes` planes in strips (strips.glsl), otherwise per pixel
// shared: none; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(constant_id = 2) const bool STRIPS = false;
layout(constant_id = 3) const bool ADD = false;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) readonly buffer Rows { vec4 rows[]; };
layout(set = 0, binding = 1, scalar) buffer ImageGradient { float image_gradient[]; };

layout(push_constant, scalar) uniform Push {
    uint image_width;
    uint image_height;
    // 3, or 4 with inverse depth.
    uint planes;
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
    vec4 gradient = rows[index];
    for (uint plane = 0; plane < planes; ++plane) {
        uint target = STRIPS ? strip_value(plane, at) : 4 * index + plane;
        image_gradient[target] = (ADD ? image_gradient[target] : 0.0) + gradient[plane];
    }
}
