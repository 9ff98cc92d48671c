// Sum of each block of a sequence: first step of the reduce-then-scan prefix sum
// (Blelloch 1990; no forward progress between workgroups is assumed).
//
// invocation: ITEMS consecutive values, in fours; subgroup: their sum; workgroup: WORKGROUP_SIZE * ITEMS values
// in:  values[n], n = counts[count_index]; out: block_sums[ceil(n / block)]
// shared: one word per subgroup; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(constant_id = 1) const uint SUBGROUP_SIZE = 32;
layout(constant_id = 2) const uint ITEMS = 4;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) readonly buffer Counts { uint counts[]; };
layout(set = 0, binding = 1, scalar) readonly buffer Values { uvec4 values[]; };
layout(set = 0, binding = 2, scalar) writeonly buffer BlockSums { uint block_sums[]; };

layout(push_constant, scalar) uniform Push { uint count_index; };

#include "dispatch.glsl"
#include "workgroup_scan.glsl"

void main() {
    uint n = counts[count_index];
    uint block = linear_workgroup();
    uint first = min(linear_invocation() * ITEMS, n);
    uint end = min(first + ITEMS, n);
    uint last_four = end / 4;
    // The last group may have fewer than four values.
    uint rest = max(last_four * 4, first);
    uint sum = 0;
    for (uint four = first / 4; four < last_four; ++four) {
        uvec4 value = values[four];
        sum += value.x + value.y + value.z + value.w;
    }
    for (uint index = rest; index < end; ++index) {
        sum += values[index / 4][index % 4];
    }
    uint total;
    workgroup_exclusive_add(sum, total);
    if (gl_LocalInvocationID.x == 0 && block * WORKGROUP_SIZE * ITEMS < n) {
        block_sums[block] = total;
    }
}
