//! The Vulkan layer on the present device.

mod context;
mod hazard;
mod kernels;
mod memory;
mod overrides;
mod profile;
mod recorder;
mod uniform;
