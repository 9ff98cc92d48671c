// Mean of parameters over the last steps of training (averaged SGD, Polyak and Juditsky 1992; in deep learning stochastic
// weight averaging, Izmailov et al. 2018): mean += weight * (value - mean), where weight is 1 over the number of steps so far.
// At the end the mean replaces the parameters. If the frame overflowed, nothing changes.
//
// invocation: one vec4 of any parameters
// in: state; in/out: values, means (laid out alike)
// shared: none; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require

#include "constants.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) buffer Values { vec4 values[]; };
layout(set = 0, binding = 1, scalar) buffer Means { vec4 means[]; };
layout(set = 0, binding = 2, scalar) readonly buffer State { uint state[]; };

layout(push_constant, scalar) uniform Push {
    uint count;
    // 1 for the first values, so that earlier means do not count.
    float weight;
    // Nonzero if the means replace the values.
    uint ends;
};

#include "dispatch.glsl"

void main() {
    uint index = linear_invocation();
    if (index >= count || state[STATE_OVERFLOW] != 0) {
        return;
    }
    if (ends != 0) {
        values[index] = means[index];
    } else if (weight == 1.0) {
        means[index] = values[index];
    } else {
        means[index] += weight * (values[index] - means[index]);
    }
}
