//! The parts that know no Vulkan: scene, files, metrics.

mod atomic;
mod camera;
mod colmap;
mod dataset;
mod files;
mod images;
mod init;
mod metrics;
mod ply;
mod sh;
