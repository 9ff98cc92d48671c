//! The engine by its kernels and as a whole: one binary, one Vulkan context.

#![allow(clippy::disallowed_methods, clippy::expect_used)]

extern crate ashsplat_reference as reference;

mod address_space;
mod architecture;
mod backends;
mod barriers;
mod blending_forms;
mod blocks;
mod budget;
mod checkpoints;
mod common;
mod determinism;
mod exposures;
mod extremes;
mod faults;
mod few_photos;
mod filters;
mod first_frames;
mod gradients;
mod hard_cases;
mod interpreted;
mod invariants;
mod kernels;
mod lenses;
mod limits;
mod lpips;
mod mcmc;
mod mock_devices;
mod offload;
mod orientations;
mod orthographic;
mod parts;
mod photos;
mod picture_parts;
mod poses;
mod properties;
mod scan;
mod several_scenes;
mod sort;
mod splats;
mod surfaces;
mod training;
mod visible_memory;
mod vk;
mod warm_up;
