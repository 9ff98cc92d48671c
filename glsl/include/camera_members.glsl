// Members of a scene's camera block: see camera_block.glsl, and scene_blocks.glsl for the blocks of all scenes.
// Rows of R (camera from world), times the object's scale if the object has one.
vec3 camera_row_x;
vec3 camera_row_y;
vec3 camera_row_z;
vec3 camera_translation;
vec2 focal_px;
vec2 center_px;
// Limits of x/z (low, high) and y/z (low, high) within which the projection is linearised.
vec4 jacobian_limits;
uint image_width;
uint image_height;
// The size of the whole picture, of which this one may be a part (engine/scene/picture_part.rs).
uint whole_width;
uint whole_height;
// 1 / scale^2.
float inverse_scale_squared;
// How Gaussians are drawn (engine/forward/shape.rs): a factor of the scales; a term added to both screen variances; an
// opacity override. The override is off at 0. If positive, it replaces every opacity; if negative, only opacities of at
// least ELLIPSOID_LEAST_OPACITY.
float shape_scale;
float shape_dilation_px2;
float shape_opacity;
// Which Gaussians are left out (engine/scene/cut.rs): those with means outside a box, with a smaller opacity logit, and
// with a smaller difference of opacity logit and largest log-scale. All finite.
vec3 cut_low;
vec3 cut_high;
float cut_opacity_logit;
float cut_log_density;
// Which Gaussians are left out at random (dropout.glsl): key, numbers below which one is left out, and the factor of the
// others' opacities. Only read with DROPOUT.
uint dropout_seed;
uint dropout_iteration;
uint dropout_below;
float dropout_factor;
// Factors of the scene's colours and opacities (engine/forward/scene_settings.rs). Only read with TINTED.
vec3 scene_tint;
float scene_opacity;
// Colour of the scene's selected Gaussians and its share in theirs. Only read with SELECTION.
vec3 selection_color;
float selection_share;
// Where the scene is: index of its first Gaussian in the frame, a multiple of a culling block; how many Gaussians take part; and
// the capacity of each of its ranges of parameters. Only read by kernels over all scenes (scene_blocks.glsl).
uint scene_first;
uint scene_count;
uint scene_chunk_gaussians;
// Of scenes that are drawn by one dispatch (engine/forward/batches.rs): the place of the first one of them in the frame, NO_BATCH
// if the scene is drawn alone; where its parameters begin in the buffer of all of them, vec4; its first cut-out and their number.
uint scene_batch;
uint scene_parameters;
uint scene_first_cut_out;
uint scene_cut_outs;
