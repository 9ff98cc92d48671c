// Exclusive prefix sum of the block sums, in place, by a single workgroup: second step of reduce-then-scan.
//
// invocation: one block sum at a time; workgroup: loops over all of them with a carry
// in/out: block_sums[first_sum ..][m], m = ceil(n / block_size); n = count, or totals[count] when from_totals is set
// out: totals[total_index] = the total, or 0xFFFFFFFF if it exceeds 32 bits: a wrapped total would look like a small one
// shared: one word per subgroup; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(constant_id = 1) const uint SUBGROUP_SIZE = 32;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) buffer BlockSums { uint block_sums[]; };
layout(set = 0, binding = 1, scalar) buffer Totals { uint totals[]; };

// If `from_totals` != 0, the number of values is totals[count], otherwise `count`. The sums start at `first_sum`.
layout(push_constant, scalar) uniform Push {
    uint count;
    uint from_totals;
    uint block_size;
    uint total_index;
    uint first_sum;
};

#include "workgroup_scan.glsl"

void main() {
    uint n = from_totals != 0 ? totals[count] : count;
    uint blocks = n / block_size + (n % block_size != 0 ? 1 : 0);
    uint carry = 0;
    bool saturated = false;
    for (uint first = 0; first < blocks; first += WORKGROUP_SIZE) {
        uint index = first + gl_LocalInvocationID.x;
        uint value = index < blocks ? block_sums[first_sum + (index < blocks ? index : 0)] : 0;
        // Sums of 16-bit halves, which cannot wrap.
        uint low_total;
        uint high_total;
        uint low = workgroup_exclusive_add(value & 0xFFFF, low_total);
        uint high = workgroup_exclusive_add(value >> 16, high_total);
        if (index < blocks) {
            block_sums[first_sum + index] = carry + (high << 16) + low;
        }
        uint next = carry + (high_total << 16) + low_total;
        saturated = saturated || high_total + (low_total >> 16) > 0xFFFF || next < carry;
        carry = next;
    }
    if (gl_LocalInvocationID.x == 0) {
        totals[total_index] = saturated ? 0xFFFFFFFF : carry;
    }
}
