// Adam over all parameters of all Gaussians in one pass (Kingma and Ba 2015; torch.optim.Adam's form):
//
//   m <- b1 m + (1 - b1) g,  v <- b2 v + (1 - b2) g^2,  p <- p - rate / (1 - b1^t) m / (sqrt(v / (1 - b2^t)) + eps)
//
// Without SPARSE, Gaussians out of view have a zero gradient, and their moments still decay. With SPARSE they do not change. SH
// gradients are computed here from the colour's gradient. Planes above the active degree have neither gradient nor moments. A
// Gaussian with a gradient that is not finite does not change, and is counted. If the frame overflowed, nothing changes. With PACKED
// the moments are those of packed_moments.glsl, in the buffers of the first ones. With HALF_SH, SH coefficients are halves: each step is
// computed in float32, then rounded up or down at random, so that steps below half a unit in the last place are not lost.
//
// invocation: one Gaussian
// in: visible_index, gradients (PerVisible planes), parameter_gradients (PerGaussian planes), state, camera block
// in/out: parameters, moments_1, moments_2 (PerGaussian planes), each bound a second time for reads;
//     state[STATE_NON_FINITE] counts the skipped Gaussians
// shared: none; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_control_flow_attributes : require
#extension GL_GOOGLE_include_directive : require

#include "constants.glsl"
#include "buffers.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(constant_id = 2) const uint SH_DEGREE = 3;
layout(constant_id = 3) const bool SPARSE = false;
layout(constant_id = 4) const bool PARAMETER_GRADIENTS = false;
// True if the device has moved the camera: its position is then in the camera block, not in the push constants.
layout(constant_id = 7) const bool MOVED_CAMERA = false;
layout(constant_id = 8) const bool SH_LOOPS = false;
layout(constant_id = 5) const bool PACKED = false;
// Only with PACKED.
layout(constant_id = 6) const bool HALF_SH = false;
#ifdef LENSES
layout(constant_id = 9) const uint PROJECTION = PROJECTION_BROWN;
#endif
layout(local_size_x_id = 0) in;

ALIASED VEC4_WRITES(0, Parameters, parameters);
ALIASED UVEC4_WRITES(1, Moments1, moments_1);
ALIASED UVEC4_WRITES(2, Moments2, moments_2);
UINT_READS(3, VisibleIndex, visible_index);
VEC4_READS(4, Gradients, gradients);
layout(set = 0, binding = 5, scalar) buffer State { uint state[]; };
// Same memory as the first three bindings. Each invocation reads its own elements before it writes them.
ALIASED VEC4_READS(6, OldParameters, old_parameters);
ALIASED UVEC4_READS(7, OldMoments1, old_moments_1);
ALIASED UVEC4_READS(8, OldMoments2, old_moments_2);
VEC4_READS(9, ParameterGradients, parameter_gradients);

layout(push_constant, scalar) uniform Push {
    vec3 camera_position;
    uint first;
    uint count;
    uint chunk_gaussians;
    uint gradient_stride;
    float beta_1;
    float beta_2;
    // 1 - b, rounded once: 1 - 0.999 in float32 is off by 5e-5.
    float one_minus_beta_1;
    float one_minus_beta_2;
    float epsilon;
    // Learning rates, divided by 1 - b1^t.
    float rate_mean;
    float rate_opacity;
    float rate_quat;
    float rate_log_scale;
    float rate_sh_dc;
    float rate_sh_rest;
    // 1 / sqrt(1 - b2^t): for all parameters except the opacity, and for the opacity, which may have fewer steps.
    float inverse_bias_2;
    float inverse_bias_2_opacity;
    // Key of the random numbers.
    uint seed;
    uint iteration;
#include "shutter_push.glsl"
};

#include "camera_block.glsl"
#include "dispatch.glsl"
#ifdef LENSES
#include "shutter_position.glsl"
#else
#include "moved_camera.glsl"
#endif
#include "random.glsl"
#include "packed_moments.glsl"
#include "planes.glsl"
#include "sh.glsl"
#include "sh_gradient.glsl"

#include "finite.glsl"

// Upper bound of the basis functions: sqrt((2 degree + 1) / (4 pi)).
float sh_largest() {
    return sqrt((2.0 * float(SH_DEGREE) + 1.0) / 12.566370614359172);
}

vec4 stepped(vec4 p, vec4 m, vec4 root, vec4 rate, vec4 inverse_bias) {
    return p - rate * (m / (root * inverse_bias + epsilon));
}

void step_parameters(uint at, vec4 m, vec4 root, vec4 rate, vec4 inverse_bias) {
    VEC4_PUT(parameters, at, stepped(VEC4_AT(old_parameters, at), m, root, rate, inverse_bias));
}

void update(uint at, vec4 g, vec4 rate, vec4 inverse_bias) {
    vec4 m = beta_1 * uintBitsToFloat(UVEC4_AT(old_moments_1, at)) + one_minus_beta_1 * g;
    vec4 v = beta_2 * uintBitsToFloat(UVEC4_AT(old_moments_2, at)) + one_minus_beta_2 * g * g;
    UVEC4_PUT(moments_1, at, floatBitsToUint(m));
    UVEC4_PUT(moments_2, at, floatBitsToUint(v));
    step_parameters(at, m, sqrt(v), rate, inverse_bias);
}

vec4 sh_rate(uint plane) {
    return plane == 0 ? vec4(vec3(rate_sh_dc), rate_sh_rest) : vec4(rate_sh_rest);
}

void update_group(uint group, uint index, vec3 d_color, vec3 direction) {
    vec4 basis = sh_basis_group(group, direction);
    [[unroll]] for (uint k = 0; k < 3; ++k) {
        uint plane = 3 * group + k;
        uint at = plane_at(PLANE_SH + plane, index, chunk_gaussians);
        if (plane < SH_PLANES) {
            update(at, sh_plane_gradient(k, basis, d_color), sh_rate(plane), vec4(inverse_bias_2));
        }
    }
}

// `direction` is the viewing direction of the forward pass.
void update_all(uint index, vec4 d_mean_opacity, vec4 d_quat, vec4 d_log_scale, vec3 d_color, vec3 direction) {
    vec4 bias = vec4(inverse_bias_2);
    update(plane_at(PLANE_MEAN_OPACITY, index, chunk_gaussians), d_mean_opacity, vec4(vec3(rate_mean), rate_opacity),
        vec4(bias.xyz, inverse_bias_2_opacity));
    update(plane_at(PLANE_QUAT, index, chunk_gaussians), d_quat, vec4(rate_quat), bias);
    update(plane_at(PLANE_LOG_SCALE, index, chunk_gaussians), d_log_scale, vec4(vec3(rate_log_scale), 0.0), bias);
#define UPDATE_GROUP(GROUP) update_group(GROUP, index, d_color, direction)
    EACH_SH_GROUP(SH_GROUPS, UPDATE_GROUP)
}

uvec4 random_words(uint index, uint plane) {
    return pcg4d(uvec4(first + index, plane, seed, 0));
}

// Returns the new words of the moments.
uvec4 update_packed(uint plane, uint index, uvec4 words, vec4 g, vec4 rate, vec4 inverse_bias) {
    vec4 m = beta_1 * from_bfloat16(words.xy) + one_minus_beta_1 * g;
    vec4 v = beta_2 * from_bfloat16(words.zw) + one_minus_beta_2 * g * g;
    step_parameters(plane_at(plane, index, chunk_gaussians), m, sqrt(v), rate, inverse_bias);
    uvec4 random = random_words(index, plane);
    uint turn = turn_of(iteration);
    return uvec4(to_bfloat16(m, thresholds_of(random.xy, turn)), to_bfloat16(v, thresholds_of(random.zw, turn)));
}

// Returns the new words of the moments. `halves` are the plane's coefficients with HALF_SH.
uvec2 update_packed_sh(uint plane, uint index, uvec2 words, vec4 g, vec2 highest, inout uvec2 halves) {
    vec4 m, root;
    unpack_sh(words, highest.x, m, root);
    m = beta_1 * m + one_minus_beta_1 * g;
    vec4 v = beta_2 * root * root + one_minus_beta_2 * g * g;
    if (HALF_SH) {
        vec4 p = vec4(unpackHalf2x16(halves.x), unpackHalf2x16(halves.y));
        p = stepped(p, m, sqrt(v), sh_rate(plane), vec4(inverse_bias_2));
        // The threshold of the first moment, half a turn on, so that both do not round up together.
        halves = to_halves(p, thresholds_of(random_words(index, PLANE_SH + plane).zw, turn_of(iteration) + 0x8000u));
    } else {
        step_parameters(plane_at(PLANE_SH + plane, index, chunk_gaussians), m, sqrt(v), sh_rate(plane), vec4(inverse_bias_2));
    }
    return pack_sh(m, v, highest.y, random_words(index, PLANE_SH + plane), turn_of(iteration));
}

// Two groups of SH, whose moments are three planes.
void update_packed_groups(uint pair, uint index, vec3 d_color, vec3 direction, vec2 highest) {
    vec4 basis[2] = vec4[2](sh_basis_group(2 * pair, direction), sh_basis_group(2 * pair + 1, direction));
    [[unroll]] for (uint k = 0; k < 6; k += 2) {
        uint plane = 6 * pair + k;
        if (plane < SH_PLANES) {
            uint at = half_plane_at(PLANE_SH + plane / 2, index, chunk_gaussians);
            uvec4 words = UVEC4_AT(old_moments_1, at);
            uvec4 halves = HALF_SH ? floatBitsToUint(VEC4_AT(old_parameters, at)) : uvec4(0);
            vec4 g = sh_plane_gradient(k % 3, basis[k / 3], d_color);
            words.xy = update_packed_sh(plane, index, words.xy, g, highest, halves.xy);
            if (plane + 1 < SH_PLANES) {
                g = sh_plane_gradient((k + 1) % 3, basis[(k + 1) / 3], d_color);
                words.zw = update_packed_sh(plane + 1, index, words.zw, g, highest, halves.zw);
            }
            UVEC4_PUT(moments_1, at, words);
            if (HALF_SH) {
                VEC4_PUT(parameters, at, uintBitsToFloat(halves));
            }
        }
    }
}

void update_all_packed(uint index, vec4 d_mean_opacity, vec4 d_quat, vec4 d_log_scale, vec3 d_color, vec3 direction) {
    vec4 bias = vec4(inverse_bias_2);
    uint at = half_plane_at(PLANE_MEAN_OPACITY, index, chunk_gaussians);
    uvec4 words = update_packed(PLANE_MEAN_OPACITY, index, UVEC4_AT(old_moments_1, at), d_mean_opacity,
        vec4(vec3(rate_mean), rate_opacity), vec4(bias.xyz, inverse_bias_2_opacity));
    UVEC4_PUT(moments_1, at, words);
    at = half_plane_at(PLANE_QUAT, index, chunk_gaussians);
    words = update_packed(PLANE_QUAT, index, UVEC4_AT(old_moments_1, at), d_quat, vec4(rate_quat), bias);
    UVEC4_PUT(moments_1, at, words);
    at = half_plane_at(PLANE_LOG_SCALE, index, chunk_gaussians);
    words = UVEC4_AT(old_moments_1, at);
    float bound = bound_of(words);
    float largest = sh_largest() * max(max(abs(d_color.r), abs(d_color.g)), abs(d_color.b));
    float new_bound = beta_2 * bound + one_minus_beta_2 * largest * largest;
    words = update_packed(PLANE_LOG_SCALE, index, with_bound(words, 0.0), d_log_scale, vec4(vec3(rate_log_scale), 0.0), bias);
    UVEC4_PUT(moments_1, at, with_bound(words, new_bound));
    vec2 highest = vec2(highest_step(bound), highest_step(new_bound));
#define UPDATE_PAIR(PAIR) update_packed_groups(PAIR, index, d_color, direction, highest)
    EACH_SH_GROUP((SH_GROUPS + 1) / 2, UPDATE_PAIR)
}

void main() {
    uint index = linear_invocation();
    if (index >= count || state[STATE_OVERFLOW] != 0) {
        return;
    }
    uint visible = UINT_AT(visible_index, first + index);
    bool seen = visible != NOT_VISIBLE;
    if (SPARSE && !seen) {
        return;
    }
    uint row = seen ? visible : 0;
    vec4 d_mean_opacity = VEC4_AT(gradients, GRADIENT_MEAN_OPACITY * gradient_stride + row);
    vec4 d_quat = VEC4_AT(gradients, GRADIENT_QUAT * gradient_stride + row);
    vec4 d_log_scale = vec4(VEC4_AT(gradients, GRADIENT_LOG_SCALE * gradient_stride + row).xyz, 0.0);
    vec4 d_color = vec4(VEC4_AT(gradients, GRADIENT_COLOR * gradient_stride + row).xyz, 0.0);
    d_mean_opacity = seen ? d_mean_opacity : vec4(0.0);
    d_quat = seen ? d_quat : vec4(0.0);
    d_log_scale = seen ? d_log_scale : vec4(0.0);
    d_color = seen ? d_color : vec4(0.0);
    if (PARAMETER_GRADIENTS) {
        d_mean_opacity += VEC4_AT(parameter_gradients, geometry_at(PLANE_MEAN_OPACITY, index));
        d_quat += VEC4_AT(parameter_gradients, geometry_at(PLANE_QUAT, index));
        d_log_scale.xyz += VEC4_AT(parameter_gradients, geometry_at(PLANE_LOG_SCALE, index)).xyz;
    }
    if (!(finite(d_mean_opacity) && finite(d_quat) && finite(d_log_scale) && finite(d_color))) {
        atomicAdd(state[STATE_NON_FINITE], 1);
        return;
    }
    // Viewing direction of the forward pass, from the mean before this step.
    vec3 mean = VEC4_AT(old_parameters, plane_at(PLANE_MEAN_OPACITY, index, chunk_gaussians)).xyz;
    // Out of view the colour has no gradient. A Gaussian at the camera's position has no direction; without this test NaN times
    // 0 would be NaN.
    vec3 direction = seen ? normalize(mean - POSITION_SEEING(mean)) : vec3(0.0);
    if (PACKED) {
        update_all_packed(index, d_mean_opacity, d_quat, d_log_scale, d_color.xyz, direction);
    } else {
        update_all(index, d_mean_opacity, d_quat, d_log_scale, d_color.xyz, direction);
    }
}
