//! The test suite: one binary, one Vulkan context.

mod common;
mod comparators;
mod gradients;
mod reference;
mod vk;
