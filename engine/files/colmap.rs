//! COLMAP's sparse models: cameras, registered images, points; binary and text.
//!
//! The observations and tracks are skipped. Format: COLMAP's documentation, "Output Format".

mod binary;
mod find;
mod model;
mod text;
mod write;

pub use find::{ModelFolder, exists, find};
pub use model::{CameraModel, ColmapCamera, ColmapImage, Model, undistort_command};
pub use write::write;
