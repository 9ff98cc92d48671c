//! Tests of code without Vulkan: scene, files, metrics.

// In a test, an unwrap is an assertion.
#![allow(clippy::unwrap_used)]

mod atomic;
mod camera;
mod cells;
mod colmap;
mod dataset;
mod distortion;
mod exif_orientation;
mod files;
mod images;
mod init;
mod ksplat;
mod lpips_weights;
mod metrics;
mod names;
mod packed;
mod photo_points;
mod photogrammetry;
mod ply;
mod splats;
mod tiles;
mod tour;
mod transform;
mod transforms;
mod usda;
mod view;
