//! Each kernel alone on the device against its twin, under the shader's name.

mod compact;
mod cull;
mod prepare;
mod project;
mod scan_apply;
mod scan_reduce;
mod scan_spine;
mod sort_count;
mod sort_scan;
mod sort_scatter;
