//! COLMAP's sparse models: cameras, registered images, points; binary and text.
//!
//! Tracks are skipped; [`observations`] and [`tracks`] read the points that each photo shows. Format: COLMAP's
//! documentation, "Output Format".

mod find;
pub(crate) mod model;
pub(crate) mod records;

pub use find::{POSES_LOG, UNFINISHED_POSES, exists, find, is_data_set};
pub(crate) use model::contradiction;
pub use model::{Model, ModelFolder, observations, tracks};
pub use records::{CameraModel, ColmapCamera, ColmapImage, write};
