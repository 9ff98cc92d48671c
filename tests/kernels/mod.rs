//! Each kernel alone on the device against its twin, under the shader's name.

mod adam;
mod blend;
mod blend_backward;
mod blend_shared;
mod compact;
mod count;
mod cull;
mod decide;
mod expand;
mod expand_gradients;
mod gather;
mod loss_reduce;
mod place;
mod prepare;
mod project;
mod project_backward;
mod ranges;
mod reset_opacity;
mod scan_apply;
mod scan_reduce;
mod scan_spine;
mod sort_count;
mod sort_scan;
mod sort_scatter;
mod ssim_backward;
mod ssim_forward;
