// Kernels that draw several scenes in one dispatch: a batch (engine/frame/batches.rs). A workgroup is a culling block of one
// scene. Here the values that kernels of one scene read from a uniform block or push constants are variables of the same names.
// Needs constants.glsl, dispatch.glsl, WORKGROUP_SIZE, SCENE_BLOCKS, and push constants: `first_block` and `end_block`, the
// first culling block of the dispatch and one past the last; `scenes` of the frame; `batch`, the place of the batch's first
// scene.
//
// shared: one word

#include "scene_blocks.glsl"
#include "camera_members.glsl"
#ifdef LENSES
#include "lens_members.glsl"
#endif

// Addresses of parameters count from the batch's buffer: see planes.glsl.
#define PARAMETERS_BEGIN scene_parameters
#define chunk_gaussians scene_chunk_gaussians

shared uint found_scene;

// Last scene that begins at or before the culling block. Scenes that are not drawn begin where the next one does.
uint scene_at(uint gaussian) {
    uint low = batch, high = scenes;
    while (high - low > 1) {
        uint middle = (low + high) / 2;
        bool before = scene_blocks[middle].scene_first <= gaussian;
        low = before ? middle : low;
        high = before ? high : middle;
    }
    return low;
}

void load_block(uint scene) {
    camera_row_x = scene_blocks[scene].camera_row_x;
    camera_row_y = scene_blocks[scene].camera_row_y;
    camera_row_z = scene_blocks[scene].camera_row_z;
    camera_translation = scene_blocks[scene].camera_translation;
    focal_px = scene_blocks[scene].focal_px;
    center_px = scene_blocks[scene].center_px;
    jacobian_limits = scene_blocks[scene].jacobian_limits;
    image_width = scene_blocks[scene].image_width;
    image_height = scene_blocks[scene].image_height;
    whole_width = scene_blocks[scene].whole_width;
    whole_height = scene_blocks[scene].whole_height;
    inverse_scale_squared = scene_blocks[scene].inverse_scale_squared;
    shape_scale = scene_blocks[scene].shape_scale;
    shape_dilation_px2 = scene_blocks[scene].shape_dilation_px2;
    shape_opacity = scene_blocks[scene].shape_opacity;
    cut_low = scene_blocks[scene].cut_low;
    cut_high = scene_blocks[scene].cut_high;
    cut_opacity_logit = scene_blocks[scene].cut_opacity_logit;
    cut_log_density = scene_blocks[scene].cut_log_density;
    dropout_seed = scene_blocks[scene].dropout_seed;
    dropout_iteration = scene_blocks[scene].dropout_iteration;
    dropout_below = scene_blocks[scene].dropout_below;
    dropout_factor = scene_blocks[scene].dropout_factor;
    scene_tint = scene_blocks[scene].scene_tint;
    scene_opacity = scene_blocks[scene].scene_opacity;
    selection_color = scene_blocks[scene].selection_color;
    selection_share = scene_blocks[scene].selection_share;
    scene_first = scene_blocks[scene].scene_first;
    scene_count = scene_blocks[scene].scene_count;
    scene_chunk_gaussians = scene_blocks[scene].scene_chunk_gaussians;
    scene_batch = scene_blocks[scene].scene_batch;
    scene_parameters = scene_blocks[scene].scene_parameters;
    scene_first_cut_out = scene_blocks[scene].scene_first_cut_out;
    scene_cut_outs = scene_blocks[scene].scene_cut_outs;
#ifdef LENSES
    lens_a = scene_blocks[scene].lens_a;
    lens_b = scene_blocks[scene].lens_b;
    lens_c = scene_blocks[scene].lens_c;
#endif
}

// Loads the values of a culling block's scene. Returns true if the batch draws it; addresses are valid in any case. It has a
// barrier, so all invocations must call it.
bool load_scene(uint block) {
    if (gl_LocalInvocationID.x == 0) {
        found_scene = scene_at(block * WORKGROUP_SIZE);
    }
    barrier();
    load_block(found_scene);
    bool own = block < end_block && scene_batch == batch;
    scene_parameters = own ? scene_parameters : 0;
    scene_cut_outs = own ? scene_cut_outs : 0;
    return own;
}
