// Members of a scene's camera block: see camera_block.glsl, and scene_blocks.glsl for the blocks of all scenes.
// Rows of R (camera from world), times the object's scale if the object has one.
vec3 camera_row_x;
vec3 camera_row_y;
vec3 camera_row_z;
vec3 camera_translation;
vec2 focal_px;
vec2 center_px;
// Limits of x/z (low, high) and y/z (low, high) between which the projection is linearised.
vec4 jacobian_limits;
uint image_width;
uint image_height;
// Size of the whole picture, of which this one may be a part (engine/scene/camera.rs).
uint whole_width;
uint whole_height;
// 1 / scale^2.
float inverse_scale_squared;
// Shape of Gaussians (engine/frame/settings.rs): a factor of the scales; a term added to both screen variances; an opacity
// override. The override is off at 0. If positive, it replaces every opacity; if negative, only opacities of at least
// ELLIPSOID_LEAST_OPACITY.
float shape_scale;
float shape_dilation_px2;
float shape_opacity;
// Limits that remove Gaussians (engine/scene/cut.rs): a box for the means, a minimum opacity logit, and a minimum difference of
// opacity logit and largest log-scale. All finite.
vec3 cut_low;
vec3 cut_high;
float cut_opacity_logit;
float cut_log_density;
// Random omission of Gaussians (dropout.glsl): key, limit of the numbers that omit one, and factor of the others' opacities.
// Only read with DROPOUT.
uint dropout_seed;
uint dropout_iteration;
uint dropout_below;
float dropout_factor;
// Factors of the scene's colours and opacities (engine/frame/settings.rs). Only read with TINTED.
vec3 scene_tint;
float scene_opacity;
// Colour of the scene's selected Gaussians, and its share. Only read with SELECTION.
vec3 selection_color;
float selection_share;
// Place of the scene: index of its first Gaussian in the frame, a multiple of a culling block; number of drawn Gaussians;
// capacity of each range of parameters. Only read by kernels over all scenes (scene_blocks.glsl).
uint scene_first;
uint scene_count;
uint scene_chunk_gaussians;
// Batch of the scene (engine/frame/batches.rs): place of the batch's first scene in the frame, or NO_BATCH; first vec4 of the
// scene's parameters in the batch's buffer; first cut-out and their number.
uint scene_batch;
uint scene_parameters;
uint scene_first_cut_out;
uint scene_cut_outs;
