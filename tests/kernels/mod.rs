//! Each kernel alone on the device against its twin, under the shader's name.

mod blend;
mod blend_backward;
mod compact;
mod count;
mod cull;
mod expand;
mod prepare;
mod project;
mod ranges;
mod scan_apply;
mod scan_reduce;
mod scan_spine;
mod sort_count;
mod sort_scan;
mod sort_scatter;
