//! 3D Gaussian Splatting (Kerbl et al., SIGGRAPH 2023) on raw Vulkan compute.

pub mod error;
pub mod io;
pub mod kernels;
pub mod metrics;
pub mod scene;
pub mod trainer;
pub mod vk;

pub use error::{Error, Result};
