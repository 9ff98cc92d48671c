// Subgroups of this device: their number of invocations, and the place of each invocation.
//
// invocation: one result; subgroup: counts its invocations by a ballot; workgroup: nothing shared
// out: found[i] = invocations of its subgroup, gl_SubgroupSize, place by gl_SubgroupID and gl_SubgroupInvocationID, and the
//     workgroup's invocation that is first in its subgroup
// shared: none; any subgroup size up to 128
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_ballot : require

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(constant_id = 1) const uint SUBGROUP_SIZE = 32;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) writeonly buffer Found { uvec4 found[]; };

layout(push_constant, scalar) uniform Push { uint count; };

#include "dispatch.glsl"

void main() {
    uint invocations = subgroupBallotBitCount(subgroupBallot(true));
    // A compiler that assumes SUBGROUP_SIZE must still read the device's value.
    uint size = max(gl_SubgroupSize, min(SUBGROUP_SIZE, 1));
    uint first = subgroupBroadcastFirst(gl_LocalInvocationID.x);
    uint index = linear_invocation();
    if (index < count) {
        found[index] = uvec4(invocations, size, gl_SubgroupID * size + gl_SubgroupInvocationID, first);
    }
}
