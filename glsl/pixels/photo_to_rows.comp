// Converts a photograph with 8 bits per channel from the loss's layout on processors to that of hosts.
//
// invocation: one pixel
// in: photo, planes of bytes in strips (strips.glsl): three, and with MASKED a fourth with the mask
// out: rows[y * image_width + x] = r | g << 8 | b << 16 | mask << 24; the mask is 255 without MASKED
// shared: none; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(constant_id = 2) const bool MASKED = false;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) readonly buffer Photo { uint photo[]; };
layout(set = 0, binding = 1, scalar) writeonly buffer Rows { uint rows[]; };

layout(push_constant, scalar) uniform Push {
    uint image_width;
    uint image_height;
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
    uint texel = MASKED ? 0 : 0xFF000000u;
    for (uint plane = 0; plane < (MASKED ? 4 : 3); ++plane) {
        uint value = strip_value(plane, at);
        texel |= (photo[value / 4] >> 8 * (value % 4) & 0xFFu) << 8 * plane;
    }
    rows[index] = texel;
}
