// Gradient of the loss with respect to a camera's lens: adds the sums of project_backward in a fixed order.
//
// invocation: a parameter and every STRIPES-th partial sum; one workgroup in all
// in: lens_sums, from the word `begin` on: LENS_SUMS values per workgroup of visible Gaussians
// out: lens_gradient, LENS_SUMS values
// shared: a value per invocation; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require

#define LENSES
#include "constants.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 128;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) readonly buffer LensSums { float lens_sums[]; };
layout(set = 0, binding = 1, scalar) writeonly buffer LensGradient { float lens_gradient[]; };

layout(push_constant, scalar) uniform Push {
    uint begin;
    // Number of partial sums per parameter.
    uint sums;
};

const uint STRIPES = WORKGROUP_SIZE / LENS_SUMS;

shared float stripe_sums[WORKGROUP_SIZE];

void main() {
    uint parameter = gl_LocalInvocationID.x % LENS_SUMS;
    float sum = 0.0;
    // The last invocations have no stripe.
    uint first = gl_LocalInvocationID.x / LENS_SUMS;
    for (uint at = first; first < STRIPES && at < sums; at += STRIPES) {
        sum += lens_sums[begin + LENS_SUMS * at + parameter];
    }
    stripe_sums[gl_LocalInvocationID.x] = sum;
    barrier();
    if (gl_LocalInvocationID.x < LENS_SUMS) {
        for (uint stripe = 1; stripe < STRIPES; ++stripe) {
            sum += stripe_sums[LENS_SUMS * stripe + parameter];
        }
        lens_gradient[parameter] = sum;
    }
}
