//! What a scene is, on the host: Gaussians, cameras, points, spherical harmonics. Knows no Vulkan.

pub mod camera;
pub mod color;
pub mod cut;
pub mod cut_out;
pub mod exposure;
pub mod filter_3d;
pub mod gaussians;
pub mod lens;
pub mod lens_effects;
pub mod orbit;
pub mod photo;
pub mod points;
pub mod sh;
pub mod sh_rotation;
pub mod stored_photo;
pub mod tour;
pub mod transform;
pub mod twist;
pub mod view;

pub use camera::{Camera, Intrinsics, scene_extent};
pub use color::{ColorEncoding, linear_from_premultiplied, linear_from_srgb, srgb_from_linear};
pub use cut::{Cut, CutLimits};
pub use cut_out::{CutOut, CutOutLimits, Inside, MAX_CUT_OUTS, Volume};
pub use exposure::Exposure;
pub use filter_3d::filtered;
pub use gaussians::{GaussianStatistics, Gaussians};
pub use lens_effects::LensEffects;
pub(crate) use lens_effects::LensPlane;
pub use orbit::Orbit;
pub use photo::Photo;
pub use points::{Bounds, PointCloud};
pub use stored_photo::{PhotoFile, StoredPhoto};
pub use tour::Motion;
pub use transform::Similarity;
pub use twist::Twist;
pub use view::{ClipY, DepthMapping, HostView, Pose};
