// Exclusive prefix sum of each digit's row of the histogram, in place, and the row's total: second step of a pass of the serial sort.
// Rows are independent, so a subgroup processes a row without barriers.
//
// invocation: one count at a time; subgroup: one digit's row, with a carry
// in/out: histogram[digit * blocks + block]; out: digit_totals[digit]
// shared: none; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#extension GL_KHR_shader_subgroup_shuffle : require

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(constant_id = 1) const uint SUBGROUP_SIZE = 32;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) readonly buffer Counts { uint counts[]; };
layout(set = 0, binding = 1, scalar) buffer Histogram { uint histogram[]; };
layout(set = 0, binding = 2, scalar) writeonly buffer DigitTotals { uint digit_totals[]; };

layout(push_constant, scalar) uniform Push {
    uint count_index;
    uint block_size;
    uint digits;
};

#include "dispatch.glsl"

void main() {
    uint n = counts[count_index];
    uint blocks = n / block_size + (n % block_size != 0 ? 1 : 0);
    uint digit = linear_workgroup() * (WORKGROUP_SIZE / SUBGROUP_SIZE) + gl_SubgroupID;
    if (digit >= digits) {
        return;
    }
    uint carry = 0;
    for (uint first = 0; first < blocks; first += SUBGROUP_SIZE) {
        uint column = first + gl_SubgroupInvocationID;
        uint index = digit * blocks + (column < blocks ? column : 0);
        uint value = column < blocks ? histogram[index] : 0;
        uint inclusive = subgroupInclusiveAdd(value);
        if (column < blocks) {
            histogram[index] = carry + inclusive - value;
        }
        carry += subgroupShuffle(inclusive, SUBGROUP_SIZE - 1);
    }
    if (gl_SubgroupInvocationID == 0) {
        digit_totals[digit] = carry;
    }
}
