//! What a scene is, on the host: Gaussians, cameras, spherical harmonics. Knows no Vulkan.

pub mod camera;
pub mod gaussians;

pub use camera::Camera;
pub use gaussians::Gaussians;
