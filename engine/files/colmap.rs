//! COLMAP's sparse models: cameras, registered images, points; binary and text.
//!
//! Tracks are skipped; [`observations`] and [`tracks`] read the points that each photo shows. Format: COLMAP's
//! documentation, "Output Format".

mod binary;
mod find;
mod model;
mod observations;
mod text;
mod types;
mod write;

pub use find::{ModelFolder, POSES_LOG, UNFINISHED_POSES, exists, find};
pub use model::{Model, undistort_command};
pub(crate) use observations::contradiction;
pub use observations::{observations, tracks};
pub use types::{CameraModel, ColmapCamera, ColmapImage};
pub use write::write;
