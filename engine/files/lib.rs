//! Files for ashsplat: PLY and the other formats of Gaussians, COLMAP, photographs, data sets, cameras.json,
//! checkpoints. Also operations on their contents: initial Gaussians, decimation, PSNR and SSIM.
//!
//! Readers do not trust the counts in a file: every count is checked against the file's size before memory is
//! reserved for it. Writers use [`atomic`], so that no partial file remains.

pub mod atomic;
pub mod cameras_json;
pub mod checkpoint;
pub mod colmap;
mod cost;
pub mod dataset;
pub mod decimate;
pub mod depth_fit;
pub mod exposure_json;
mod file_hash;
pub mod host_memory;
pub mod images;
pub mod init;
pub mod lens_json;
pub mod lpips_weights;
pub mod metrics;
mod names;
pub mod photo_points;
pub mod ply;
mod progress;
pub mod regular_file;
mod sniff;
pub mod splats;
pub mod text;
pub mod tiles;
pub mod transforms;

pub use checkpoint::CheckpointFile;
pub use dataset::{Dataset, DatasetOptions, DatasetReport, Gallery, View};
pub use file_hash::file_hash;
pub use host_memory::HostMemory;
pub use images::{Photo, PhotoFileFormat, PhotoMemory, PhotoOrientation, Resolution, StoredPhoto};
pub use init::initial_gaussians;
pub use lpips_weights::WeightsFile;
pub use names::{has_photo_ending, has_video_ending, quoted};
pub use progress::Progress;

#[cfg(test)]
#[path = "../../tests/growth/mod.rs"]
mod growth;
