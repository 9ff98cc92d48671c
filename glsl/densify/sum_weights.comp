// Weight of each Gaussian in a view: the sum of its instances' weights (blend_backward.comp, WEIGHTS), in a fixed order; 0 for
// Gaussians that are not visible. Also the smallest and the largest weight.
//
// invocation: one Gaussian; subgroup: adds the instances of a Gaussian with many tiles together, like project_backward.comp
// in: state, visible_index, footprints, first_instances, instance_gradients_c (weight, 0)
// out: weights[Gaussian]; ranges, see edges.glsl: bits of the smallest and of the largest weight; nothing if the frame
//     overflowed
// shared: none; subgroup sizes 4 to 128
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#extension GL_KHR_shader_subgroup_ballot : require
#extension GL_KHR_shader_subgroup_shuffle : require

#include "constants.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 128;
layout(constant_id = 1) const uint SUBGROUP_SIZE = 32;
// A Gaussian with more instances is summed by its whole subgroup.
layout(constant_id = 3) const uint LANE_INSTANCES = 64;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) readonly buffer State { uint state[]; };
layout(set = 0, binding = 1, scalar) readonly buffer VisibleIndex { uint visible_index[]; };
layout(set = 0, binding = 2, scalar) readonly buffer Footprints { uvec4 footprints[]; };
layout(set = 0, binding = 3, scalar) readonly buffer FirstInstances { uint first_instances[]; };
layout(set = 0, binding = 4, scalar) readonly buffer InstanceGradientsC { vec2 instance_gradients_c[]; };
layout(set = 0, binding = 5, scalar) writeonly buffer Weights { float weights[]; };
layout(set = 0, binding = 6, scalar) buffer Ranges { uint ranges[]; };

layout(push_constant, scalar) uniform Push {
    uint count;
    uint splat_stride;
};

#include "dispatch.glsl"
#include "edges.glsl"
#include "splat_record.glsl"
#include "subgroup.glsl"

float sum_instances(uint begin, uint count) {
    float sum = 0.0;
    uint alone = count <= LANE_INSTANCES ? count : 0;
    for (uint k = 0; k < alone; ++k) {
        sum += instance_gradients_c[begin + k].x;
    }
    uvec4 large = subgroupBallot(count > LANE_INSTANCES);
    for (uint word = 0; word < BALLOT_WORDS; ++word) {
        uint bits = large[word];
        while (bits != 0) {
            uint lane = findLSB(bits) + 32 * word;
            bits &= bits - 1;
            uint their_begin = subgroupShuffle(begin, lane);
            uint their_count = subgroupShuffle(count, lane);
            float share = 0.0;
            for (uint k = gl_SubgroupInvocationID; k < their_count; k += SUBGROUP_SIZE) {
                share += instance_gradients_c[their_begin + k].x;
            }
            share = subgroupAdd(share);
            sum = gl_SubgroupInvocationID == lane ? share : sum;
        }
    }
    return sum;
}

void main() {
    uint index = linear_invocation();
    bool exists = index < count && state[STATE_OVERFLOW] == 0;
    uint visible = visible_index[exists ? index : 0];
    bool seen = exists && visible != NOT_VISIBLE;
    uint row = seen ? visible : 0;
    uint instances = seen ? footprints[splat_at(row, SPLAT_FOOTPRINT)].w : 0;
    uint begin = instances == 0 ? 0 : first_instances[row];
    // Nonnegative, so its bits sort like its value.
    float weight = max(sum_instances(begin, instances), 0.0);
    uint low = subgroupMax(exists ? ~floatBitsToUint(weight) : 0);
    uint high = subgroupMax(exists ? floatBitsToUint(weight) : 0);
    if (gl_SubgroupInvocationID == 0) {
        atomicMax(ranges[RANGE_WEIGHT_LOW], low);
        atomicMax(ranges[RANGE_WEIGHT_HIGH], high);
    }
    if (exists) {
        weights[index] = weight;
    }
}
