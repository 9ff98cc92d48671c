//! What a scene is, on the host: Gaussians, cameras, points, spherical harmonics. Knows no Vulkan.

pub mod camera;
pub mod decimate;
pub mod gaussians;
pub mod init;
pub mod lens;
pub mod orbit;
pub mod points;
pub mod sh;
pub mod sh_rotation;
pub mod transform;
pub mod view;

pub use camera::{Camera, Intrinsics, scene_extent};
pub use gaussians::{GaussianStatistics, Gaussians};
pub use orbit::Orbit;
pub use points::{Bounds, PointCloud};
pub use transform::Similarity;
pub use view::{ClipY, DepthMapping, HostView, Pose};
