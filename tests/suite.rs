//! The test suite: one binary, one Vulkan context.

mod architecture;
mod cli;
mod common;
mod comparators;
mod gradients;
mod host;
mod kernels;
mod reference;
mod vk;
