//! COLMAP's sparse models: cameras, registered images, points; binary and text.
//!
//! The observations and tracks are skipped. Format: COLMAP's documentation, "Output Format".

mod binary;
mod find;
mod model;
mod text;
mod types;
mod write;

pub use find::{ModelFolder, UNFINISHED_POSES, exists, find};
pub use model::{Model, undistort_command};
pub use types::{CameraModel, ColmapCamera, ColmapImage};
pub use write::write;
