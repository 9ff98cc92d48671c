//! COLMAP's sparse models: cameras, registered images, points; binary and text.
//!
//! Tracks are skipped; [`observations`] reads where photos show points. Format: COLMAP's documentation, "Output Format".

mod binary;
mod find;
mod model;
mod observations;
mod text;
mod types;
mod write;

pub use find::{ModelFolder, UNFINISHED_POSES, exists, find};
pub use model::{Model, undistort_command};
pub use observations::observations;
pub use types::{CameraModel, ColmapCamera, ColmapImage};
pub use write::write;
