// Adam over the exposures of all photographs as one tensor, or over the effects of all lenses (lens_effects.glsl). It steps
// all matrices. Only the current view's has a gradient: the sum of the partials, or 0 if that is not finite. Weight decay
// adds `decay` times each value to its gradient. With CENTER, for exposures, it leaves out the diagonal, which holds the
// gains per channel.
//
// With SHARES all photographs share the second moments: their squared gradients add up, without the parts of `decay`.
// Otherwise Adam would move photographs that fit as fast as those that do not.
//
// With SPARSE a step then brings the matrix closer to the identity by `sparsity` times the rate. This decreases with its
// distance and is 0 from FREE_DISTANCE on: the minimax concave penalty (Zhang 2010). Photographs without a clear change keep
// none, and clear gains do not shrink.
//
// With CENTER, the mean over the photographs is then moved back to the identity: E <- E - mean(E) + [I | 0]. Otherwise the
// scene could grow brighter while all exposures grow darker, and pictures without an exposure would drift.
// If the frame overflowed, nothing changes.
//
// invocation: every WORKGROUP_SIZE-th photograph; one workgroup in all
// in: partials[3 * TERM_PARTIALS], state
// in/out: exposures, moments_1, moments_2: three rows per photograph
// shared: three vec4 per subgroup; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require

#include "constants.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(constant_id = 1) const uint SUBGROUP_SIZE = 32;
layout(constant_id = 2) const bool CENTER = true;
layout(constant_id = 4) const bool SHARES = false;
layout(constant_id = 5) const bool SPARSE = false;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) readonly buffer Partials { vec4 partials[]; };
layout(set = 0, binding = 1, scalar) readonly buffer State { uint state[]; };
layout(set = 0, binding = 2, scalar) buffer Exposures { vec4 exposures[]; };
layout(set = 0, binding = 3, scalar) buffer Moments1 { vec4 moments_1[]; };
layout(set = 0, binding = 4, scalar) buffer Moments2 { vec4 moments_2[]; };

layout(push_constant, scalar) uniform Push {
    uint photographs;
    uint view;
    // Divided by 1 - b1^t.
    float rate;
    // 1 / sqrt(1 - b2^t).
    float inverse_bias_2;
    // Weight decay: factor of each value in its gradient.
    float decay;
    // With SPARSE: distance per rate.
    float sparsity;
};

// Distance between a matrix and the identity: root of the sum of squares of all twelve numbers.
const float FREE_DISTANCE = 0.05;

#include "adam_constants.glsl"
#include "exposure_sums.glsl"
#include "finite.glsl"

// Gradient of a row for the step, without the part of `decay`.
vec4 gradient_of(uint photograph, vec4 of_view) {
    return photograph == view ? of_view : vec4(0.0);
}

void main() {
    vec4 gradient[3] = vec4[3](vec4(0.0), vec4(0.0), vec4(0.0));
    for (uint index = gl_LocalInvocationID.x; index < TERM_PARTIALS; index += WORKGROUP_SIZE) {
        for (uint k = 0; k < 3; ++k) {
            gradient[k] += partials[3 * index + k];
        }
    }
    add_over_workgroup(gradient);
    bool sound = finite(gradient[0]) && finite(gradient[1]) && finite(gradient[2]);
    for (uint k = 0; k < 3; ++k) {
        gradient[k] = sound ? gradient[k] : vec4(0.0);
    }
    uint end = state[STATE_OVERFLOW] == 0 ? photographs : 0;
    vec4 squares[3] = vec4[3](vec4(0.0), vec4(0.0), vec4(0.0));
    if (SHARES) {
        for (uint photograph = gl_LocalInvocationID.x; photograph < end; photograph += WORKGROUP_SIZE) {
            for (uint k = 0; k < 3; ++k) {
                vec4 g = gradient_of(photograph, gradient[k]);
                squares[k] += g * g;
            }
        }
        add_over_workgroup(squares);
    }
    vec4 mean[3] = vec4[3](vec4(0.0), vec4(0.0), vec4(0.0));
    for (uint photograph = gl_LocalInvocationID.x; photograph < end; photograph += WORKGROUP_SIZE) {
        vec4 change[3] = vec4[3](vec4(0.0), vec4(0.0), vec4(0.0));
        for (uint k = 0; k < 3; ++k) {
            uint at = 3 * photograph + k;
            vec4 g = gradient_of(photograph, gradient[k]);
            vec4 e = exposures[at];
            vec4 pulled = e;
            pulled[k] *= CENTER ? 0.0 : 1.0;
            g += decay * pulled;
            vec4 m = ADAM_BETA_1 * moments_1[at] + ADAM_ONE_MINUS_BETA_1 * g;
            vec4 square = SHARES ? ADAM_ONE_MINUS_BETA_2 * squares[k] : ADAM_ONE_MINUS_BETA_2 * g * g;
            vec4 v = ADAM_BETA_2 * moments_2[at] + square;
            moments_1[at] = m;
            moments_2[at] = v;
            e -= rate * (m / (sqrt(v) * inverse_bias_2 + ADAM_EPSILON));
            if (!SPARSE) {
                exposures[at] = e;
            }
            // Distance from the identity, because small numbers add up with small errors.
            e[k] -= 1.0;
            change[k] = e;
        }
        float keeps = 1.0;
        if (SPARSE) {
            float distance = sqrt(dot(change[0], change[0]) + dot(change[1], change[1]) + dot(change[2], change[2]));
            float pull = rate * sparsity * max(0.0, 1.0 - distance / FREE_DISTANCE);
            keeps = distance > pull ? 1.0 - pull / distance : 0.0;
        }
        for (uint k = 0; k < 3; ++k) {
            vec4 kept = change[k] * keeps;
            mean[k] += kept;
            if (SPARSE) {
                kept[k] += 1.0;
                exposures[3 * photograph + k] = kept;
            }
        }
    }
    if (CENTER) {
        add_over_workgroup(mean);
        for (uint photograph = gl_LocalInvocationID.x; photograph < end; photograph += WORKGROUP_SIZE) {
            for (uint k = 0; k < 3; ++k) {
                exposures[3 * photograph + k] -= mean[k] / float(photographs);
            }
        }
    }
}
