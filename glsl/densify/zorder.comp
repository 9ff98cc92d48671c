// Position of each row of the new set on a Z-order curve (Morton 1966) through all space. Sorting by it places Gaussians that
// are close in the scene, and so in most pictures, close in memory.
//
// Each axis is folded into (-1, 1) by d / (1 + |d|), where d is the distance from the cameras' mean position in scene extents.
// The folded axis has 1024 cells, half of them within one extent.
//
// invocation: one row of the new set; it returns at once if the row's source lies outside the bound range
// in: sources[row], parameters (PerGaussian planes); out: keys[row] < 2^ZORDER_BITS, the cell's bits interleaved, x lowest
// shared: none; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require

#include "constants.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) readonly buffer Sources { uint sources[]; };
layout(set = 0, binding = 1, scalar) readonly buffer Parameters { vec4 parameters[]; };
layout(set = 0, binding = 2, scalar) writeonly buffer Keys { uint keys[]; };

layout(push_constant, scalar) uniform Push {
    uint first;
    uint count;
    uint rows;
    // Mean position of the cameras, and extent of the scene.
    vec3 center;
    float extent;
};

#include "dispatch.glsl"
#include "planes.glsl"

const uint CELLS = 1 << (ZORDER_BITS / 3);

uint cell(float distance) {
    float folded = distance / (1.0 + abs(distance));
    // NaN and infinity go to the first cell. The test reads their bits, because a compiler may assume that no value is NaN.
    bool placed = (floatBitsToUint(distance) & 0x7F800000) != 0x7F800000;
    return placed ? min(uint(max(0.5 + 0.5 * folded, 0.0) * float(CELLS)), CELLS - 1) : 0;
}

// Inserts two zero bits after each of the lower ten bits.
uint spread(uint v) {
    v = (v | v << 16) & 0x030000FF;
    v = (v | v << 8) & 0x0300F00F;
    v = (v | v << 4) & 0x030C30C3;
    return (v | v << 2) & 0x09249249;
}

void main() {
    uint row = linear_invocation();
    if (row >= rows) {
        return;
    }
    uint index = (sources[row] & ((1 << KIND_SHIFT) - 1)) - first;
    if (index >= count) {
        return;
    }
    vec3 d = (parameters[geometry_at(PLANE_MEAN_OPACITY, index)].xyz - center) / extent;
    keys[row] = spread(cell(d.x)) | spread(cell(d.y)) << 1 | spread(cell(d.z)) << 2;
}
