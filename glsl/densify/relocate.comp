// Gives drawn Gaussians and their copies the opacity and scale with which they together look like the original (3DGS-MCMC,
// Kheradmand et al. 2024, equation 9). For n Gaussians, o' = 1 - (1 - o)^(1/n), and the scale is multiplied by o / D, where D =
// 2/sqrt(pi) * integral over u > 0 of 1 - (1 - o' exp(-u^2))^n. Their moments become zero.
//
// invocation: one row of the new set
// in: sources[row] = Gaussian of the old set | kind << KIND_SHIFT; draws[Gaussian]
// in/out: parameters, moments_1, moments_2 (PerGaussian planes) of the new set
// shared: none; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_spirv_intrinsics : require

#include "constants.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) readonly buffer Sources { uint sources[]; };
layout(set = 0, binding = 1, scalar) readonly buffer Draws { uint draws[]; };
layout(set = 0, binding = 2, scalar) buffer Parameters { vec4 parameters[]; };
// Packed moments are bound twice, so both are decorated as aliased.
spirv_decorate(20) layout(set = 0, binding = 3, scalar) writeonly buffer Moments1 { uvec4 moments_1[]; };
spirv_decorate(20) layout(set = 0, binding = 4, scalar) writeonly buffer Moments2 { uvec4 moments_2[]; };

layout(push_constant, scalar) uniform Push {
    uint first;
    uint count;
    uint chunk_gaussians;
    uint planes;
    // 1 for moments of packed_moments.glsl, all of which are in `moments_1`.
    uint packed_moments;
};

#include "dispatch.glsl"
#include "opacity.glsl"
#include "planes.glsl"

// Step of the trapezoid rule, which ends where the integrand is below 1e-14.
const float STEP = 0.25;
const uint STEPS = 24;
const float TWO_OVER_SQRT_PI = 1.1283791670955126;

// log(1 + x) = 2 artanh(x / (2 + x)), without cancellation near 0. The series covers a wide range, because between 0.5 and 2 a
// GPU's logarithm may have an absolute error of 2^-21, even if its value is small.
float log1p(float x) {
    float s = x / (2.0 + x);
    float q = s * s;
    float series = 2.0 * s * (1.0 + q * (0.33333334 + q * (0.2 + q * (0.14285715 + q * 0.11111111))));
    return abs(x) < 0.3 ? series : log(1.0 + x);
}

// exp(x) - 1 without cancellation near 0.
float expm1(float x) {
    return abs(x) < 0.1
               ? x * (1.0 + x * (0.5 + x * (0.16666667 + x * (0.041666668 + x * (0.008333334 + x * 0.0013888889)))))
               : exp(x) - 1.0;
}

void main() {
    uint row = linear_invocation();
    if (row >= count) {
        return;
    }
    uint drawn = draws[sources[first + row] & ((1 << KIND_SHIFT) - 1)];
    if (drawn == 0) {
        return;
    }
    float n = float(min(drawn + 1, RELOCATION_MOST));
    uint at = geometry_at(PLANE_MEAN_OPACITY, row);
    float logit = parameters[at].w;
    float opacity = opacity_of(logit);
    // Computes log(1 - o) from the logit, because 1 - o has few digits if o is close to 1.
    float log_transparency = logit > 0.0 ? -logit - log1p(exp(-logit)) : -log1p(exp(logit));
    float shared_opacity =
        clamp(-expm1(log_transparency / n), RELOCATION_LEAST_OPACITY, RELOCATION_MOST_OPACITY);
    float sum = 0.0;
    for (uint k = 0; k < STEPS; ++k) {
        float u = STEP * float(k);
        float value = -expm1(n * log1p(-shared_opacity * exp(-u * u)));
        sum += k == 0 ? 0.5 * value : value;
    }
    parameters[at].w = log(shared_opacity / (1.0 - shared_opacity));
    parameters[geometry_at(PLANE_LOG_SCALE, row)].xyz += log(opacity / (TWO_OVER_SQRT_PI * STEP * sum));
    for (uint plane = 0; plane < planes; ++plane) {
        uint at = packed_moments == 1 ? half_plane_at(plane, row, chunk_gaussians) : plane_at(plane, row, chunk_gaussians);
        moments_1[at] = uvec4(0);
        moments_2[at] = uvec4(0);
    }
}
