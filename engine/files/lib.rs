//! Files for ashsplat: PLY and the other formats of Gaussians, COLMAP, photographs, data sets, cameras.json,
//! checkpoints. Also operations on their contents: initial Gaussians, decimation, PSNR and SSIM.
//!
//! Readers do not trust the counts in a file: every count is checked against the file's size before memory is
//! reserved for it. Writers use [`atomic`], so that no partial file remains.
//!
//! Unless a function names other errors, they are [`Error::Io`](ashsplat::Error::Io) with the file that the system
//! cannot read or write; [`Error::Input`](ashsplat::Error::Input) for a file of another kind, damaged or cut short;
//! [`Error::TooLarge`](ashsplat::Error::TooLarge) when the machine or a budget has too little memory for it;
//! [`Error::Argument`](ashsplat::Error::Argument) for an invalid argument, or for arguments that do not fit together;
//! [`Error::Interrupted`](ashsplat::Error::Interrupted) when a [`Progress`] requests the stop.

#![cfg_attr(test, allow(clippy::disallowed_methods, clippy::expect_used))]

pub mod atomic;
pub mod cameras_json;
pub mod checkpoint;
pub mod colmap;
mod cost;
pub mod dataset;
pub mod decimate;
pub mod depth_fit;
pub mod exposure_json;
pub mod host_memory;
pub mod images;
pub mod init;
pub mod lens_json;
pub mod lpips_weights;
pub mod mesh;
pub mod metrics;
mod names;
pub mod photo_points;
pub mod photogrammetry;
pub mod ply;
mod progress;
pub mod regular_file;
pub mod splats;
pub mod text;
pub mod tiles;
pub mod transforms;

pub use checkpoint::CheckpointFile;
pub use dataset::{AlphaUse, Dataset, DatasetOptions, DatasetReport, EvalSplit, Gallery, Level, View};
pub use host_memory::HostMemory;
pub use images::{Photo, PhotoFileFormat, PhotoMemory, PhotoOrientation, Resolution, StoredPhoto};
pub use init::initial_gaussians;
pub use names::{has_other_picture_ending, has_photo_ending, has_video_ending, quoted};
pub use progress::Progress;
pub use regular_file::file_hash;

#[cfg(test)]
#[path = "../../tests/growth/mod.rs"]
mod growth;
