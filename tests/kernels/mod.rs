//! Tests of each kernel alone on the device against its twin. Their names begin with the shader's.

pub mod blend;
pub mod blend_backward;
mod compose;
pub mod cull;
pub mod densify;
pub mod draws;
mod exposure;
pub mod filter_3d;
pub mod lists;
mod loss;
mod optimizer;
mod pixels;
pub mod poses;
mod project;
pub mod project_backward;
pub mod scan;
mod screen_motion;
pub mod sort;
pub mod ssim;
pub mod surface;
mod surface_loss;
