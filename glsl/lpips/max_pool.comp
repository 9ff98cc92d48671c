// Max pooling without padding: out(y, x) = max over ky, kx of in(STRIDE y + ky, STRIDE x + kx), in each channel.
//
// A dispatch's grid: (pixels, blocks of channels, pictures).
//
// invocation: four channels of a pixel
// in: inputs, a map (feature_map.glsl) without a margin; out: outputs, rows first to first + rows of a map
// shared: none; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require

#include "buffers.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(constant_id = 2) const uint SIZE = 2;
layout(constant_id = 3) const uint STRIDE = 2;
layout(local_size_x_id = 0) in;

VEC4_READS(0, Inputs, inputs);
VEC4_WRITES(1, Outputs, outputs);

layout(push_constant, scalar) uniform Push {
    uint blocks;
    uint in_height;
    uint in_slots;
    uint in_pitch;
    uint out_width;
    uint out_slots;
    uint out_pitch;
    uint out_margin;
    uint first;
    uint rows;
};

#include "feature_map.glsl"

void main() {
    uint index = gl_WorkGroupID.x * WORKGROUP_SIZE + gl_LocalInvocationID.x;
    if (index >= out_width * rows) {
        return;
    }
    uint x = index % out_width;
    uint y = first + index / out_width;
    uint plane = gl_WorkGroupID.z * blocks + gl_WorkGroupID.y;
    uint column = plane * map_plane(in_slots, in_pitch) + STRIDE * x;
    // Features are outputs of a ReLU, so they are at least 0.
    vec4 largest = vec4(0.0);
    for (uint ky = 0; ky < SIZE; ++ky) {
        uint at = column + map_slot(int(STRIDE * y + ky), in_height, in_slots) * in_pitch;
        for (uint kx = 0; kx < SIZE; ++kx) {
            largest = max(largest, VEC4_AT(inputs, at + kx));
        }
    }
    uint target = plane * map_plane(out_slots, out_pitch) + y % out_slots * out_pitch + out_margin + x;
    VEC4_PUT(outputs, target, largest);
}
