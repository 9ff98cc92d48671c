// Keys of a draw without replacement, in proportion to chances c. With u uniform in (0, 1), the n largest ln(u) / c are such a
// draw (Efraimidis and Spirakis 2006). The key is -ln(u) / c, so the n smallest are drawn. It is a nonnegative float, so its
// bits sort like its value.
//
// invocation: one Gaussian
// in: statistics (sum, views); importance; with EXPLICIT_UNIFORMS uniforms[Gaussian]
// out: keys[Gaussian], NOT_DRAWN for those that cannot be drawn; selected[Gaussian] = 0;
//      totals[TOTAL_CANDIDATES] += number of those that can
// shared: none; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require

#include "constants.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(constant_id = 1) const uint SUBGROUP_SIZE = 32;
layout(constant_id = 2) const bool EXPLICIT_UNIFORMS = false;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) readonly buffer Statistics { vec2 statistics[]; };
layout(set = 0, binding = 1, scalar) readonly buffer Importance { float importance[]; };
layout(set = 0, binding = 2, scalar) readonly buffer Uniforms { float uniforms[]; };
layout(set = 0, binding = 3, scalar) writeonly buffer Keys { uint keys[]; };
layout(set = 0, binding = 4, scalar) writeonly buffer Selected { uint selected[]; };
layout(set = 0, binding = 5, scalar) buffer Totals { uint totals[]; };

layout(push_constant, scalar) uniform Push {
    uint count;
    // Minimum mean over the views for a Gaussian to be drawn.
    float threshold;
    // CHANCE_*.
    uint chances;
    uint seed;
    uint iteration;
};

#include "dispatch.glsl"
#include "random.glsl"

// Distinguishes these numbers from those of other draws with the same key.
const uint STREAM = 5;

// -ln(u) for 0 < u < 1, to some units in the last place. The relevant keys have u near 1, where log() may be off by a
// thousandth. With u = m 2^e and m in [1/2, 1), both parts of -ln(u) = -e ln(2) + 2 atanh((1 - m) / (1 + m)) are nonnegative.
float minus_log(float u) {
    uint bits = floatBitsToUint(u);
    float exponent = float(int(bits >> 23 & 0xFFu) - 126);
    float m = uintBitsToFloat(bits & 0x007FFFFFu | 0x3F000000u);
    // At most 1/3: the next term of the series is below 2^-24 of the sum.
    float z = (1.0 - m) / (1.0 + m);
    float zz = z * z;
    float series = 1.0 + zz * (1.0 / 3.0 + zz * (1.0 / 5.0 + zz * (1.0 / 7.0 + zz * (1.0 / 9.0 + zz * (1.0 / 11.0 + zz * (1.0 / 13.0))))));
    return 2.0 * z * series - exponent * 0.6931471805599453;
}

void main() {
    uint index = linear_invocation();
    bool exists = index < count;
    uint gaussian = exists ? index : 0;
    vec2 statistic = statistics[gaussian];
    float mean = statistic.y > 0.0 ? statistic.x / statistic.y : 0.0;
    float chance = chances == CHANCE_IMPORTANCE ? importance[gaussian] : chances == CHANCE_STATISTIC ? mean : 1.0;
    bool can = exists && statistic.y > 0.0 && mean >= threshold && chance > 0.0;
    uint bits = pcg4d(uvec4(seed, iteration, gaussian, STREAM)).x;
    // 23 bits exclude 0 and 1.
    float drawn = (float(bits >> 9) + 0.5) / 8388608.0;
    float u = EXPLICIT_UNIFORMS ? uniforms[gaussian] : drawn;
    if (exists) {
        keys[index] = can ? floatBitsToUint(minus_log(u) / chance) : NOT_DRAWN;
        selected[index] = 0;
    }
    uint candidates = subgroupAdd(can ? 1u : 0u);
    if (gl_SubgroupInvocationID == 0 && candidates > 0) {
        atomicAdd(totals[TOTAL_CANDIDATES], candidates);
    }
}
