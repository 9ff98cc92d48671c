// Classification for adaptive density control (paper, section 5.2; reference densify_and_prune): decides which Gaussians stay,
// are cloned, or are split. Excludes Gaussians that the reference prunes later.
//
// SELECTED splits the selected Gaussians at any scale, and clones none (Improved-GS).
//
// invocation: one Gaussian; workgroup: one block of WORKGROUP_SIZE Gaussians
// in: parameters (PerGaussian planes), statistics (sum of NDC gradient norms, views), with SELECTED selected (nonzero for a split)
// out: decisions[Gaussian] = bit 0 stays, bit 1 cloned, bit 2 split into two;
//      block_counts[decision * blocks + block], blocks = ceil(total / WORKGROUP_SIZE)
// shared: one word per subgroup; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require

#include "constants.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(constant_id = 1) const uint SUBGROUP_SIZE = 32;
// The children of a split are those of long_axis.glsl.
layout(constant_id = 2) const bool LONG_AXIS = false;
layout(constant_id = 3) const bool SELECTED = false;
layout(local_size_x_id = 0) in;

layout(set = 0, binding = 0, scalar) readonly buffer Parameters { vec4 parameters[]; };
layout(set = 0, binding = 1, scalar) readonly buffer Statistics { vec2 statistics[]; };
layout(set = 0, binding = 2, scalar) writeonly buffer Decisions { uint decisions[]; };
layout(set = 0, binding = 3, scalar) writeonly buffer BlockCounts { uint block_counts[]; };
layout(set = 0, binding = 4, scalar) readonly buffer Selected { uint selected[]; };

layout(push_constant, scalar) uniform Push {
    uint first;
    uint count;
    uint blocks;
    float gradient_threshold;
    // Largest scale of a clone; larger Gaussians are split, world units.
    float clone_scale;
    float min_opacity;
    // Largest scale that stays, world units; 0 for no limit.
    float max_scale;
};

#include "dispatch.glsl"
#include "long_axis.glsl"
#include "opacity.glsl"
#include "planes.glsl"
#include "workgroup_scan.glsl"

void main() {
    uint local = linear_invocation();
    bool exists = local < count;
    uint index = exists ? local : 0;
    float opacity = opacity_of(parameters[geometry_at(PLANE_MEAN_OPACITY, index)].w);
    vec3 scale = exp(parameters[geometry_at(PLANE_LOG_SCALE, index)].xyz);
    float largest = max(scale.x, max(scale.y, scale.z));
    vec2 statistic = statistics[first + index];
    float gradient = statistic.y > 0.0 ? statistic.x / statistic.y : 0.0;

    bool grows = gradient >= gradient_threshold;
    bool splits = grows && largest > clone_scale;
    if (SELECTED) {
        grows = selected[first + index] != 0;
        splits = grows;
    }
    bool clones = grows && !splits;
    bool faint = opacity < min_opacity;
    bool too_large = max_scale > 0.0 && largest > max_scale;
    bool child_too_large = max_scale > 0.0 && largest / SPLIT_FACTOR > max_scale;
    bool child_faint = faint;
    if (LONG_AXIS) {
        vec3 child = exp(long_axis_log_scale(parameters[geometry_at(PLANE_LOG_SCALE, index)].xyz));
        child_too_large = max_scale > 0.0 && max(child.x, max(child.y, child.z)) > max_scale;
        child_faint = LONG_AXIS_OPACITY * opacity < min_opacity;
    }
    uint stays = exists && !splits && !faint && !too_large ? 1 : 0;
    uint cloned = clones ? stays : 0;
    uint split = exists && splits && !child_faint && !child_too_large ? 1 : 0;
    if (exists) {
        decisions[first + local] = stays | cloned << 1 | split << 2;
    }
    uint totals[3];
    workgroup_exclusive_add(stays, totals[0]);
    workgroup_exclusive_add(cloned, totals[1]);
    workgroup_exclusive_add(split, totals[2]);
    if (gl_LocalInvocationID.x == 0 && exists) {
        uint block = (first + local) / WORKGROUP_SIZE;
        block_counts[block] = totals[0];
        block_counts[blocks + block] = totals[1];
        block_counts[2 * blocks + block] = totals[2];
    }
}
