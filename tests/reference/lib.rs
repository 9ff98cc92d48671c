//! Plain-loop twins of the kernels in double precision: the judge of the GPU. Each shader has a file of its name,
//! written from the paper and the reference implementation's definitions without a line of the engine. Kernels that
//! compute the same in another way share a twin.

// The names are those of the formulas.
#![allow(missing_docs)]
// Loops over indices read like the formulas.
#![allow(clippy::needless_range_loop)]

pub mod adam;
pub mod add_gradients;
pub mod add_importance;
pub mod add_noise;
pub mod average;
pub mod blend;
pub mod blend_backward;
pub mod classify;
pub mod compact;
pub mod compose_rgba32f;
pub mod compose_rgba8;
pub mod convolve;
pub mod count;
pub mod cull;
pub mod depth_limit;
pub mod draw_keys;
pub mod draw_sources;
pub mod draw_weights;
pub mod duplicate_with_tiles;
pub mod edge_gradient;
pub mod edge_response;
pub mod expand_gradients;
pub mod expected_depth;
pub mod expose;
pub mod expose_backward;
pub mod exposure_step;
pub mod feature_difference;
pub mod filter_sizes;
pub mod gather;
pub mod gradient_from_rows;
pub mod inverse_depth_l1;
pub mod lens_backward;
pub mod lens_effects;
pub mod linear;
pub mod loss_reduce;
pub mod lpips;
pub mod mark_drawn;
pub mod mask_outside;
pub mod max_pool;
pub mod mean_motion;
pub mod multiply_add;
pub mod nearest_depths;
pub mod opacity_keys;
pub mod photo_reduced;
pub mod photo_to_rows;
pub mod picks;
pub mod picture_to_rows;
pub mod pipeline;
pub mod pose_gradient;
pub mod pose_step;
pub mod project;
pub mod project_backward;
pub mod ranges;
pub mod regularize;
pub mod relocate;
pub mod reset_opacity;
pub mod scan_apply;
pub mod scan_reduce;
pub mod scan_spine;
pub mod scatter_sources;
pub mod schedule;
pub mod screen_motion;
pub mod sh;
pub mod sort;
pub mod sort_downsweep;
pub mod sort_downsweep_serial;
pub mod sort_single_subgroup;
pub mod sort_spine;
pub mod sort_upsweep;
pub mod sort_upsweep_serial;
pub mod sparse_depth;
pub mod sparse_depth_gather;
pub mod ssim_backward;
pub mod ssim_forward;
pub mod subgroup_probe;
pub mod sum_weights;
pub mod term_reduce;
pub mod tile_list;
pub mod tiles;
pub mod types;
pub mod write_indirect_args;
pub mod write_visible_ranges;
pub mod zorder;
