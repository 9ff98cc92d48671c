// Culls the scenes of a batch (batch.glsl) in one dispatch, with the same bits as cull.comp scene by scene. Blocks of other
// scenes between them are unchanged.
//
// invocation: one Gaussian; workgroup: one block of WORKGROUP_SIZE Gaussians, of one scene
// in: parameters (PerGaussian planes of all scenes), scene_blocks[scene], with CUT_OUTS cut_outs (64 bytes each), with SHARED_ORDER
//     visible_flags; out: visible_flags[Gaussian], block_counts[block], zero where there is no Gaussian
// shared: one word, and one per subgroup; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require

#include "constants.glsl"
#include "buffers.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
layout(constant_id = 1) const uint SUBGROUP_SIZE = 32;
// Same as in cull.comp. Frames with dropout have no batches.
layout(constant_id = 3) const bool FILTER_3D = false;
layout(constant_id = 5) const bool TINTED = false;
layout(constant_id = 6) const bool CUT_OUTS = false;
layout(constant_id = 7) const uint PROJECTION = PROJECTION_PERSPECTIVE;
layout(constant_id = 8) const bool SHARED_ORDER = false;
#ifdef LENSES
layout(constant_id = 9) const bool SHUTTER = false;
#endif
const bool DROPOUT = false;
layout(local_size_x_id = 0) in;

VEC4_READS(0, Parameters, parameters);
layout(set = 0, binding = 1, scalar) buffer VisibleFlags { uint visible_flags[]; };
layout(set = 0, binding = 2, scalar) writeonly buffer BlockCounts { uint block_counts[]; };
VEC4_READS(3, CutOuts, cut_outs);

layout(push_constant, scalar) uniform Push {
    // See batch.glsl.
    uint first_block;
    uint end_block;
    uint scenes;
    uint batch;
    // Number of indices in the frame: each has a flag.
    uint index_count;
    // Same as in cull.comp.
    uint extent;
    uint antialias;
#include "shutter_push.glsl"
};

#define DRAWS_SHAPES
#define SCENE_BLOCKS 4
#include "dispatch.glsl"
#include "batch.glsl"
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
    uint block = first_block + linear_workgroup();
    bool own = load_scene(block);
    uint gaussian = block * WORKGROUP_SIZE + gl_LocalInvocationID.x;
    uint local = gaussian - scene_first;
    bool exists = own && local < scene_count;
    uint index = exists ? local : 0;
    bool visible = is_shown(gaussian, index, scene_first_cut_out, scene_cut_outs);
    write_flag(gaussian, own && gaussian < index_count, exists, visible);
}
