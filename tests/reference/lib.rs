//! Twins of the kernels: plain loops in double precision that judge the GPU. Each shader has a function here, written from
//! the paper and the reference implementation without a line of the engine. Kernels that compute the same in another way
//! share a twin.

#![allow(clippy::expect_used)]
// The names are those of the formulas.
#![allow(missing_docs)]
// Loops over indices read like the formulas.
#![allow(clippy::needless_range_loop)]

pub mod adam;
pub mod add_noise;
pub mod blend;
pub mod blend_backward;
pub mod classify;
pub mod compose;
pub mod cull;
pub mod draws;
pub mod exposure;
pub mod filter_sizes;
pub mod gather;
pub mod inverse_depth_l1;
pub mod linear;
pub mod lists;
pub mod loss;
pub mod lpips;
pub mod nearest_depths;
pub mod pipeline;
pub mod pixels;
pub mod pose_gradient;
pub mod pose_step;
pub mod project;
pub mod project_backward;
pub mod regularize;
pub mod relocate;
pub mod reset_opacity;
pub mod scan;
pub mod scatter_sources;
pub mod schedule;
pub mod sh;
pub mod sort;
pub mod sparse_depth;
pub mod sparse_depth_gather;
pub mod splat_surface;
pub mod ssim;
pub mod surface;
pub mod surface_loss;
pub mod tiles;
pub mod types;
pub mod zorder;
