//! The test suite: one binary, one Vulkan context.

mod architecture;
mod common;
mod comparators;
mod gradients;
mod reference;
mod vk;
