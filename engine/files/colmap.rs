//! COLMAP's sparse models: cameras, registered images, points; binary and text.
//!
//! Tracks are skipped; [`observations`] and [`tracks`] read the points that each photo shows. Format: COLMAP's
//! documentation, "Output Format".

mod find;
mod model;
mod read;
mod records;
mod rigs;
mod write;

pub use find::{ModelFolder, POSES_LOG, UNFINISHED_POSES, exists, find, is_data_set};
pub(crate) use model::contradiction;
pub use model::{Model, observations, tracks};
pub use records::{CameraModel, ColmapCamera, ColmapImage};
pub use write::write;
