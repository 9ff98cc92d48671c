//! The Vulkan layer on the device at hand.

mod context;
mod hazard;
mod kernels;
mod memory;
mod overrides;
mod profile;
mod recorder;
mod uniform;
