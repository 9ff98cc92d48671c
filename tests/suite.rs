//! The test suite: one binary, one Vulkan context.

mod architecture;
mod barriers;
mod bench;
mod checkpoints;
mod cli;
mod common;
mod comparators;
mod determinism;
mod extremes;
mod faults;
mod gradients;
mod hard_cases;
mod host;
mod invariants;
mod kernels;
mod limits;
mod profile;
mod properties;
mod reference;
mod scan;
mod soak;
mod sort;
mod splats;
mod subgroup_widths;
mod training;
mod vk;
