//! Scenes on the host: Gaussians, cameras, points, spherical harmonics. Independent of Vulkan.

pub mod camera;
pub mod cells;
pub mod color;
pub mod cut;
pub mod cut_out;
pub mod distortion;
pub mod exposure;
pub mod filter_3d;
mod fingerprint;
pub mod gaussians;
pub mod lens_effects;
pub mod orbit;
pub mod photo;
pub mod points;
pub mod sh;
pub mod sh_rotation;
pub mod stored_photo;
pub mod strays;
pub mod tour;
pub mod transform;
pub mod twist;
pub mod view;
pub mod world_frame;

pub use camera::{Camera, Intrinsics, JacobianLimit, NEAR_PLANE, PicturePart, Projection, scene_extent};
pub use cells::{Cells, Seam};
pub use color::{ColorEncoding, linear_from_premultiplied, linear_from_srgb, srgb_from_linear};
pub use cut::{Cut, CutLimits};
pub use cut_out::{CutOut, CutOutLimits, Inside, MAX_CUT_OUTS, Volume};
pub use exposure::Exposure;
pub use filter_3d::filtered;
pub use fingerprint::Fingerprint;
pub use gaussians::{GaussianStatistics, Gaussians};
pub use lens_effects::LensEffects;
pub(crate) use lens_effects::LensPlane;
pub use orbit::Orbit;
pub use photo::Photo;

pub use points::{Bounds, PointCloud, SourcePoints};
pub use stored_photo::{PhotoFile, StoredPhoto};
pub use strays::{far_camera, median_ball, strays, without_strays};
pub use tour::Motion;
pub use transform::Similarity;
pub use twist::Twist;
pub use view::{ClipY, DepthMapping, HostView, Pose};
pub use world_frame::WorldFrame;
