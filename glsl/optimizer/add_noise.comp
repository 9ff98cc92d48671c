// Moves means at random (3DGS-MCMC, Kheradmand et al. 2024, section 4), by rate * sigmoid(-100 (o - 0.005)) * cov * n. Here cov
// is the Gaussian's covariance and n has three standard normal numbers. Opaque Gaussians stay in place. If the frame
// overflowed, nothing changes.
//
// invocation: one Gaussian of a chunk
// in: state; in/out: parameters (PerGaussian planes)
// shared: none; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require

#include "constants.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
// Normal numbers come from `noise`[Gaussian] instead of the generator, for comparisons.
layout(constant_id = 2) const bool EXPLICIT_NOISE = false;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) buffer Parameters { vec4 parameters[]; };
layout(set = 0, binding = 1, scalar) readonly buffer State { uint state[]; };
layout(set = 0, binding = 2, scalar) readonly buffer Noise { vec3 noise[]; };

layout(push_constant, scalar) uniform Push {
    uint first;
    uint count;
    uint seed;
    uint iteration;
    float rate;
};

#include "dispatch.glsl"
#include "opacity.glsl"
#include "planes.glsl"
#include "random.glsl"

// Distinguishes these numbers from others with the same seed and iteration.
const uint STREAM = 4;
const float SHARPNESS = 100.0;

void main() {
    uint index = linear_invocation();
    if (index >= count || state[STATE_OVERFLOW] != 0) {
        return;
    }
    uint at = geometry_at(PLANE_MEAN_OPACITY, index);
    float opacity = opacity_of(parameters[at].w);
    float gate = 1.0 / (1.0 + exp(SHARPNESS * (opacity - RELOCATION_LEAST_OPACITY)));
    vec4 quat = parameters[geometry_at(PLANE_QUAT, index)];
    vec3 scale = exp(parameters[geometry_at(PLANE_LOG_SCALE, index)].xyz);
    float norm = length(quat);
    vec4 q = norm > QUAT_NORM_MIN ? quat / norm : vec4(1.0, 0.0, 0.0, 0.0);
    vec3 normal =
        EXPLICIT_NOISE ? noise[first + index] : random_normal(uvec4(seed, iteration, first + index, STREAM));
    // Transforms to the Gaussian's own axes and back.
    vec3 own = normal + 2.0 * cross(-q.yzw, cross(-q.yzw, normal) + q.x * normal);
    own *= scale * scale;
    vec3 world = own + 2.0 * cross(q.yzw, cross(q.yzw, own) + q.x * own);
    parameters[at].xyz += rate * gate * world;
}
