//! Training: from photographs and a sparse point cloud to Gaussians.

pub mod settings;

pub use settings::{OptimizerType, TrainSettings};
