// Draws the sources of a new set with replacement (3DGS-MCMC, Kheradmand et al. 2024, section 4). A row whose Gaussian has a
// weight keeps it. All other rows, and those beyond the old set, get a Gaussian drawn in proportion to the weights.
//
// invocation: one row of the new set
// in: weights[Gaussian], prefix[Gaussian] = sum of the weights before, totals[1] = their sum
// out: sources[row] = Gaussian | kind << KIND_SHIFT; draws[Gaussian] = number of times it was drawn
// shared: none; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require

#include "constants.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
// Uniform numbers come from `uniforms`[row] instead of the generator, for comparisons.
layout(constant_id = 2) const bool EXPLICIT_UNIFORMS = false;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) readonly buffer Weights { uint weights[]; };
layout(set = 0, binding = 1, scalar) readonly buffer Prefix { uint prefix[]; };
layout(set = 0, binding = 2, scalar) readonly buffer Totals { uint totals[]; };
layout(set = 0, binding = 3, scalar) readonly buffer Uniforms { float uniforms[]; };
layout(set = 0, binding = 4, scalar) writeonly buffer Sources { uint sources[]; };
layout(set = 0, binding = 5, scalar) buffer Draws { uint draws[]; };

layout(push_constant, scalar) uniform Push {
    // Number of Gaussians in the old set, number of rows in the new one.
    uint count;
    uint rows;
    uint seed;
    uint iteration;
    // Distinguishes the draws of an iteration.
    uint stream;
};

#include "dispatch.glsl"
#include "random.glsl"

// Gaussian whose part of the sum of weights contains a place.
uint gaussian_at(uint place) {
    uint low = 0;
    uint high = count - 1;
    while (low < high) {
        uint middle = low + (high - low + 1) / 2;
        if (prefix[middle] <= place) {
            low = middle;
        } else {
            high = middle - 1;
        }
    }
    return low;
}

void main() {
    uint row = linear_invocation();
    if (row >= rows) {
        return;
    }
    bool exists = row < count;
    // If nothing can be drawn, the old set stays.
    if (exists && weights[row] > 0 || totals[1] == 0) {
        sources[row] = min(row, count - 1) | KIND_KEPT << KIND_SHIFT;
        return;
    }
    uint bits = EXPLICIT_UNIFORMS ? uint(uniforms[row] * 16777216.0) << 8 : pcg4d(uvec4(seed, iteration, row, stream)).x;
    uint place, low_half;
    umulExtended(bits, totals[1], place, low_half);
    uint source = gaussian_at(place);
    sources[row] = source | KIND_CLONE << KIND_SHIFT;
    atomicAdd(draws[source], 1);
}
