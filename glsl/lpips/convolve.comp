// A convolution and its ReLU for AlexNet and VGG16: out(o, y, x) = max(0, bias(o) + sum over i, ky, kx of weight(o, i, ky, kx)
// * in(i, STRIDE y + ky - padding, STRIDE x + kx - padding)).
//
// Each weight is read once for ROWS rows. A dispatch's grid: (columns and groups of rows, blocks of output channels, pictures).
//
// invocation: four output channels of a column of ROWS rows, from row `first` on
// in: inputs, a map (feature_map.glsl) with a margin of `padding`; weights of four output channels in the order (output block,
//     ky, input block, kx, input of the block); biases of four output channels
// out: outputs, rows first to first + rows of a map
// shared: none; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require

#include "buffers.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(constant_id = 2) const uint SIZE = 3;
layout(constant_id = 3) const uint STRIDE = 1;
layout(constant_id = 4) const uint ROWS = 4;
layout(local_size_x_id = 0) in;

VEC4_READS(0, Inputs, inputs);
VEC4_READS(1, Weights, weights);
VEC4_READS(2, Biases, biases);
VEC4_WRITES(3, Outputs, outputs);

layout(push_constant, scalar) uniform Push {
    uint in_blocks;
    uint in_height;
    uint in_slots;
    uint in_pitch;
    uint padding;
    uint out_blocks;
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
    if (index >= out_width * ((rows + ROWS - 1) / ROWS)) {
        return;
    }
    uint x = index % out_width;
    uint top = index / out_width * ROWS;
    uint block = gl_WorkGroupID.y;
    uint picture = gl_WorkGroupID.z;
    uint in_plane = map_plane(in_slots, in_pitch);
    uint column = picture * in_blocks * in_plane + STRIDE * x;
    uint weight = 4 * block * SIZE * in_blocks * SIZE;
    vec4 sums[ROWS];
    for (uint j = 0; j < ROWS; ++j) {
        sums[j] = VEC4_AT(biases, block);
    }
    for (uint ky = 0; ky < SIZE; ++ky) {
        uint at[ROWS];
        for (uint j = 0; j < ROWS; ++j) {
            int y = int(STRIDE * (first + top + j) + ky) - int(padding);
            at[j] = column + map_slot(y, in_height, in_slots) * in_pitch;
        }
        for (uint i = 0; i < in_blocks; ++i) {
            for (uint kx = 0; kx < SIZE; ++kx) {
                mat4 w = mat4(VEC4_AT(weights, weight), VEC4_AT(weights, weight + 1), VEC4_AT(weights, weight + 2),
                              VEC4_AT(weights, weight + 3));
                weight += 4;
                for (uint j = 0; j < ROWS; ++j) {
                    sums[j] += w * VEC4_AT(inputs, at[j] + kx);
                }
            }
            for (uint j = 0; j < ROWS; ++j) {
                at[j] += in_plane;
            }
        }
    }
    uint out_plane = map_plane(out_slots, out_pitch);
    uint target = (picture * out_blocks + block) * out_plane + out_margin + x;
    for (uint j = 0; j < ROWS && top + j < rows; ++j) {
        VEC4_PUT(outputs, target + (first + top + j) % out_slots * out_pitch, max(sums[j], vec4(0.0)));
    }
}
