// Exclusive prefix sum within each block plus the block's offset: last step of reduce-then-scan.
//
// invocation: ITEMS consecutive values, in fours; workgroup: one block of WORKGROUP_SIZE * ITEMS values
// in: values[n], block_offsets[ceil(n / block)]; out: prefix[n], prefix[i] = values[0] + ... + values[i - 1]
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
layout(set = 0, binding = 2, scalar) readonly buffer BlockOffsets { uint block_offsets[]; };
layout(set = 0, binding = 3, scalar) writeonly buffer Prefix { uvec4 prefix[]; };

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
    uint running = workgroup_exclusive_add(sum, total);
    // A workgroup past the end has no offset, so it reads an existing one.
    running += block_offsets[min(block, n == 0 ? 0 : (n - 1) / (WORKGROUP_SIZE * ITEMS))];
    for (uint four = first / 4; four < last_four; ++four) {
        uvec4 value = values[four];
        uvec3 before = uvec3(value.x, value.x + value.y, value.x + value.y + value.z);
        prefix[four] = running + uvec4(0, before);
        running += before.z + value.w;
    }
    for (uint index = rest; index < end; ++index) {
        prefix[index / 4][index % 4] = running;
        running += values[index / 4][index % 4];
    }
}
