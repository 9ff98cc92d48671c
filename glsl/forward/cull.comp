// Visibility of each Gaussian, and the number of visible ones in each block: first step of the stable compaction. Culls by
// the near plane, a degenerate covariance, an opacity below 1/255, and an empty set of tiles (paper, section 6; reference
// preprocessCUDA). Leaves out what the settings cut, and with DROPOUT some at random. With TINTED opacities have the scene's
// factor, with CUT_OUTS volumes keep or remove what lies inside. With ADDS, what an earlier view of the same Gaussians sees is
// visible, too.
//
// invocation: one Gaussian; workgroup: one block of WORKGROUP_SIZE Gaussians
// in: parameters (PerGaussian planes), with CUT_OUTS cut_outs (64 bytes each), with ADDS visible_flags; out: visible_flags[Gaussian], block_counts[block],
//     zero where there is no Gaussian
// shared: one word per subgroup; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require

#include "constants.glsl"
#include "buffers.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(constant_id = 1) const uint SUBGROUP_SIZE = 32;
// Whether Gaussians have a 3D filter: see projection.glsl.
layout(constant_id = 3) const bool FILTER_3D = false;
// Whether some are left out at random: see dropout.glsl.
layout(constant_id = 4) const bool DROPOUT = false;
// Whether the scene has an opacity of its own: see camera_block.glsl.
layout(constant_id = 5) const bool TINTED = false;
// Whether volumes keep or remove Gaussians: see cut_outs.glsl.
layout(constant_id = 6) const bool CUT_OUTS = false;
// Whether the camera's rays are parallel: see projection.glsl.
layout(constant_id = 7) const bool ORTHOGRAPHIC = false;
// Whether the flags hold what an earlier view sees.
layout(constant_id = 8) const bool ADDS = false;
layout(local_size_x_id = 0) in;

VEC4_READS(0, Parameters, parameters);
layout(set = 0, binding = 1, scalar) buffer VisibleFlags { uint visible_flags[]; };
layout(set = 0, binding = 2, scalar) writeonly buffer BlockCounts { uint block_counts[]; };
VEC4_READS(3, CutOuts, cut_outs);

layout(push_constant, scalar) uniform Push {
    // First Gaussian of the bound parameter range, number of Gaussians, and capacity of the range.
    uint first;
    uint count;
    uint chunk_gaussians;
    // `extent` is EXTENT_EXACT or EXTENT_REFERENCE, `antialias` of ANTIALIAS_ bits.
    uint extent;
    uint antialias;
    // With CUT_OUTS: those of the scene.
    uint first_cut_out;
    uint cut_out_count;
    // Indices that have flags: those of the Gaussians, and of the gap between them and the next scene.
    uint flag_count;
};

#define DRAWS_SHAPES
#include "camera_block.glsl"
#include "dispatch.glsl"
#include "planes.glsl"
#include "workgroup_scan.glsl"
#include "tile_span.glsl"
#include "filter_3d.glsl"
#include "projection.glsl"
#include "random.glsl"
#include "dropout.glsl"
#include "cut_outs.glsl"

// As CutLimits::keeps (engine/scene/cut.rs), bit for bit: comparisons and one subtraction.
bool kept(vec3 mean, vec3 log_scale, float opacity_logit) {
    precise float log_density = opacity_logit - max(max(log_scale.x, log_scale.y), log_scale.z);
    return all(greaterThanEqual(mean, cut_low)) && all(lessThanEqual(mean, cut_high))
        && opacity_logit >= cut_opacity_logit && log_density >= cut_log_density;
}

void main() {
    uint local = linear_invocation();
    bool exists = local < count;
    uint index = exists ? local : 0;
    vec4 mean_opacity = VEC4_AT(parameters, plane_at(PLANE_MEAN_OPACITY, index, chunk_gaussians));
    vec4 quat = VEC4_AT(parameters, plane_at(PLANE_QUAT, index, chunk_gaussians));
    vec4 log_scale = VEC4_AT(parameters, plane_at(PLANE_LOG_SCALE, index, chunk_gaussians));
    Filtered filtered = filter_3d(log_scale, mean_opacity.w);
    Projection p = project_gaussian(mean_opacity.xyz, quat, filtered.log_scale);
    Footprint f = footprint_of(p, filtered.opacity_logit);
    bool visible = f.visible && kept(mean_opacity.xyz, log_scale.xyz, mean_opacity.w);
    if (DROPOUT) {
        visible = visible && !dropped_out(first + index);
    }
    if (CUT_OUTS) {
        visible = visible && kept_by_cut_outs(first_cut_out, cut_out_count, mean_opacity.xyz);
    }
    // The other invocations read no flag: the first one writes that of `index`.
    if (ADDS && exists) {
        visible = visible || visible_flags[first + index] != 0;
    }
    uint flag = exists && visible ? 1 : 0;
    if (local < flag_count) {
        visible_flags[first + local] = flag;
    }
    uint total;
    workgroup_exclusive_add(flag, total);
    if (gl_LocalInvocationID.x == 0 && local < flag_count) {
        block_counts[(first + local) / WORKGROUP_SIZE] = total;
    }
}
