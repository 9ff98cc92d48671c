// Marks the Gaussians with the smallest keys of a draw (draw_keys.comp).
//
// invocation: one place of the sorted keys
// in: sorted[place], the Gaussian at a place of the sorted keys; in/out: totals[TOTAL_CANDIDATES], totals[TOTAL_DRAWN]
// out: selected[Gaussian] = 1 for the first min(wanted, candidates) Gaussians
// shared: none; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require

#include "constants.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) readonly buffer Sorted { uint sorted[]; };
layout(set = 0, binding = 1, scalar) buffer Totals { uint totals[]; };
layout(set = 0, binding = 2, scalar) writeonly buffer Selected { uint selected[]; };

layout(push_constant, scalar) uniform Push {
    uint count;
    uint wanted;
};

#include "dispatch.glsl"

void main() {
    uint place = linear_invocation();
    uint drawn = min(min(wanted, totals[TOTAL_CANDIDATES]), count);
    if (place == 0) {
        totals[TOTAL_DRAWN] = drawn;
    }
    if (place < drawn) {
        selected[sorted[place]] = 1;
    }
}
