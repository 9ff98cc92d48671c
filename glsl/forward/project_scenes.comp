// Screen-space attributes of the visible Gaussians of a batch (batch.glsl), in one dispatch, with the same bits as project.comp
// scene by scene.
//
// invocation: one visible Gaussian; workgroup: the visible ones of one culling block, which belongs to one scene
// in: parameters (PerGaussian planes of all scenes), scene_blocks[scene], visible_list, block_offsets[block]: visible Gaussians
//     before each culling block; state[STATE_VISIBLE]; out, PerVisible: same as project.comp
// shared: one word; any subgroup size
#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_control_flow_attributes : require
#extension GL_GOOGLE_include_directive : require

#include "constants.glsl"
#include "buffers.glsl"

layout(constant_id = 0) const uint WORKGROUP_SIZE = 256;
// Same as in project.comp. Frames with dropout have no batches, and scenes with a selection are outside batches.
layout(constant_id = 1) const bool DISTANCE_ORDER = false;
layout(constant_id = 2) const uint SH_DEGREE = 3;
layout(constant_id = 3) const bool FILTER_3D = false;
layout(constant_id = 6) const bool TINTED = false;
layout(constant_id = 8) const uint PROJECTION = PROJECTION_PERSPECTIVE;
layout(constant_id = 9) const bool SH_LOOPS = false;
layout(constant_id = 10) const bool SHARED_ORDER = false;
#ifdef LENSES
layout(constant_id = 11) const bool SHUTTER = false;
#endif
const bool DROPOUT = false;
const bool Z_RECORD = false;
layout(local_size_x_id = 0) in;

VEC4_READS(0, Parameters, parameters);
UINT_READS(1, BlockOffsets, block_offsets);
UINT_READS(2, VisibleList, visible_list);
layout(set = 0, binding = 3, scalar) writeonly buffer Mean2dExtent { vec4 mean2d_extent[]; };
layout(set = 0, binding = 4, scalar) writeonly buffer ConicOpacity { vec4 conic_opacity[]; };
layout(set = 0, binding = 5, scalar) writeonly buffer ColorInverseDepth { vec4 color_inverse_depth[]; };
layout(set = 0, binding = 6, scalar) writeonly buffer DepthKeys { uint depth_keys[]; };
layout(set = 0, binding = 7, scalar) writeonly buffer Footprints { uvec4 footprints[]; };
layout(set = 0, binding = 8, scalar) writeonly buffer TileLists { uvec2 tile_lists[]; };
layout(set = 0, binding = 9, scalar) readonly buffer State { uint state[]; };

layout(push_constant, scalar) uniform Push {
    // See batch.glsl.
    uint first_block;
    uint end_block;
    uint scenes;
    uint batch;
    // Number of culling blocks in the frame.
    uint blocks;
    // Same as in project.comp.
    uint extent;
    uint antialias;
    uint splat_stride;
#include "shutter_push.glsl"
};

#define DRAWS_SHAPES
#define SCENE_BLOCKS 10
#include "dispatch.glsl"
#include "batch.glsl"
#include "planes.glsl"
#include "splat_record.glsl"
#include "tile_span.glsl"
#include "filter_3d.glsl"
#include "project_gaussian.glsl"
#include "sh.glsl"
#include "sh_planes.glsl"

vec3 highlighted(vec3 color, uint index) {
    return color;
}

#include "write_splat.glsl"

void main() {
    uint block = min(first_block + linear_workgroup(), blocks);
    bool own = load_scene(block);
    // Same computation as in compact.comp.
    uint all = state[STATE_VISIBLE];
    uint next = UINT_AT(block_offsets, block + 1 < blocks ? block + 1 : 0);
    uint visible = min(UINT_AT(block_offsets, min(block, blocks - 1)), all) + gl_LocalInvocationID.x;
    if (!own || visible >= (block + 1 < blocks ? min(next, all) : all)) {
        return;
    }
    write_splat(visible, UINT_AT(visible_list, visible) - scene_first);
}
