// Visibility of each Gaussian, and the number of visible ones in each block: first step of the stable compaction. Culls by the
// near plane, a degenerate covariance, an opacity below 1/255, and an empty set of tiles (paper, section 6; reference
// preprocessCUDA). Applies the settings' cut, and with DROPOUT random omission. With TINTED opacities have the scene's factor,
// and with CUT_OUTS volumes keep or remove Gaussians. With SHARED_ORDER, Gaussians that are visible in an earlier view stay visible.
//
// invocation: one Gaussian; workgroup: one block of WORKGROUP_SIZE Gaussians
// in: parameters (PerGaussian planes), with CUT_OUTS cut_outs (64 bytes each), with SHARED_ORDER visible_flags; out:
//     visible_flags[Gaussian], block_counts[block], zero without a Gaussian
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
// True if Gaussians have a 3D filter: see project_gaussian.glsl.
layout(constant_id = 3) const bool FILTER_3D = false;
// True if random Gaussians are omitted: see dropout.glsl.
layout(constant_id = 4) const bool DROPOUT = false;
// True if the scene has its own opacity: see camera_block.glsl.
layout(constant_id = 5) const bool TINTED = false;
// True if volumes keep or remove Gaussians: see cut_outs.glsl.
layout(constant_id = 6) const bool CUT_OUTS = false;
// Projection of the camera: see pinhole.glsl.
layout(constant_id = 7) const uint PROJECTION = PROJECTION_PERSPECTIVE;
// True if the flags already hold the visible Gaussians of an earlier view.
layout(constant_id = 8) const bool SHARED_ORDER = false;
#ifdef LENSES
// True for a rolling shutter: see shutter.glsl.
layout(constant_id = 9) const bool SHUTTER = false;
#endif
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
    // `extent` is EXTENT_EXACT or EXTENT_REFERENCE; `antialias` has ANTIALIAS_ bits.
    uint extent;
    uint antialias;
    // With CUT_OUTS: the scene's first cut-out and their number.
    uint first_cut_out;
    uint cut_out_count;
    // Number of indices with flags: those of the Gaussians, and of the gap before the next scene.
    uint flag_count;
#include "shutter_push.glsl"
};

#define DRAWS_SHAPES
#include "camera_block.glsl"
#include "dispatch.glsl"
#include "planes.glsl"
#include "workgroup_scan.glsl"
#include "tile_span.glsl"
#include "filter_3d.glsl"
#include "project_gaussian.glsl"
#include "random.glsl"
#include "dropout.glsl"
#include "cut_outs.glsl"
#include "culling.glsl"

void main() {
    uint local = linear_invocation();
    bool exists = local < count;
    uint index = exists ? local : 0;
    bool visible = is_shown(first + index, index, first_cut_out, cut_out_count);
    write_flag(first + local, local < flag_count, exists, visible);
}
