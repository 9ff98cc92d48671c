//! Files: PLY and the other formats of Gaussians, COLMAP, photographs, data sets, cameras.json. Knows no Vulkan.
//!
//! Readers trust nothing that a file says about itself: every count is checked against the file's size before
//! memory is reserved for it. Writers go through [`atomic`], so that no partial file is ever left behind.

pub mod atomic;
pub mod cameras_json;
pub mod colmap;
pub mod dataset;
pub mod images;
mod names;
pub mod ply;
mod progress;
mod sniff;
pub mod splats;
pub mod transforms;

pub use dataset::{Dataset, DatasetOptions, DatasetReport, Gallery, View};
pub use images::{Photo, PhotoMemory, PhotoOrientation, Resolution, StoredPhoto};
pub use progress::Progress;
