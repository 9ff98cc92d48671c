// The optimiser's step, whichever way its inputs are read: see adam.comp.
// Needs constants.glsl, SH_DEGREE, SPARSE, `parameters`, `moments_1`, `moments_2`, `state`, and parameter_at,
// moment_1_at, moment_2_at, gradient_at, visible_index_at.

layout(push_constant, scalar) uniform Push {
    vec3 camera_position;
    uint first;
    uint count;
    uint stride;
    uint gradient_stride;
    float beta_1;
    float beta_2;
    // 1 - b, rounded once: 1 - 0.999 in float32 is off by 5e-5.
    float one_minus_beta_1;
    float one_minus_beta_2;
    float epsilon;
    // Learning rates, already divided by 1 - b1^t.
    float rate_mean;
    float rate_opacity;
    float rate_quat;
    float rate_log_scale;
    float rate_sh_dc;
    float rate_sh_rest;
    // 1 / sqrt(1 - b2^t): for all parameters but the opacity, whose steps may be fewer, and for the opacity.
    float inverse_bias_2;
    float inverse_bias_2_opacity;
};

#include "dispatch.glsl"
#include "sh.glsl"
#include "sh_gradient.glsl"

void update(uint plane, uint index, vec4 g, vec4 rate, vec4 inverse_bias) {
    uint at = plane * stride + index;
    vec4 m = beta_1 * moment_1_at(at) + one_minus_beta_1 * g;
    vec4 v = beta_2 * moment_2_at(at) + one_minus_beta_2 * g * g;
    moments_1[at] = m;
    moments_2[at] = v;
    parameters[at] = parameter_at(at) - rate * (m / (sqrt(v) * inverse_bias + epsilon));
}

bool finite(vec4 g) {
    uvec4 exponent = floatBitsToUint(g) & 0x7F800000u;
    return all(notEqual(exponent, uvec4(0x7F800000u)));
}

void main() {
    uint index = linear_invocation();
    if (index >= count || state[STATE_OVERFLOW] != 0) {
        return;
    }
    uint visible = visible_index_at(first + index);
    bool seen = visible != NOT_VISIBLE;
    if (SPARSE && !seen) {
        return;
    }
    uint row = seen ? visible : 0;
    vec4 d_mean_opacity = gradient_at(GRADIENT_MEAN_OPACITY * gradient_stride + row);
    vec4 d_quat = gradient_at(GRADIENT_QUAT * gradient_stride + row);
    vec4 d_log_scale = vec4(gradient_at(GRADIENT_LOG_SCALE * gradient_stride + row).xyz, 0.0);
    vec4 d_color = vec4(gradient_at(GRADIENT_COLOR * gradient_stride + row).xyz, 0.0);
    d_mean_opacity = seen ? d_mean_opacity : vec4(0.0);
    d_quat = seen ? d_quat : vec4(0.0);
    d_log_scale = seen ? d_log_scale : vec4(0.0);
    d_color = seen ? d_color : vec4(0.0);
    if (!(finite(d_mean_opacity) && finite(d_quat) && finite(d_log_scale) && finite(d_color))) {
        atomicAdd(state[STATE_NON_FINITE], 1);
        return;
    }
    // The direction is that of the forward pass: it needs the mean from before this step.
    vec3 mean = parameter_at(PLANE_MEAN_OPACITY * stride + index).xyz;
    float basis[16];
    // Outside the view the colour has no gradient, but a Gaussian at the camera has no direction: NaN times 0 is NaN.
    sh_basis(seen ? normalize(mean - camera_position) : vec3(0.0), basis);

    vec4 bias = vec4(inverse_bias_2);
    update(PLANE_MEAN_OPACITY, index, d_mean_opacity, vec4(vec3(rate_mean), rate_opacity),
        vec4(bias.xyz, inverse_bias_2_opacity));
    update(PLANE_QUAT, index, d_quat, vec4(rate_quat), bias);
    update(PLANE_LOG_SCALE, index, d_log_scale, vec4(vec3(rate_log_scale), 0.0), bias);
    [[unroll]] for (uint plane = 0; plane < SH_PLANES; ++plane) {
        vec4 rate = plane == 0 ? vec4(vec3(rate_sh_dc), rate_sh_rest) : vec4(rate_sh_rest);
        update(PLANE_SH + plane, index, sh_plane_gradient(plane, basis, d_color.xyz), rate, bias);
    }
}
