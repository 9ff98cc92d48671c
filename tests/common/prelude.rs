//! Types and fixtures that most tests of the engine use.

pub use ashsplat::train::{Checkpoint, StepReport, StrategyType, TrainView, Trainer};
pub use ashsplat::vk::{Context, ContextOptions, LimitsOverride, MemoryKind, SpecOverride};
pub use ashsplat::{Camera, Error, Frame, Gaussians, RenderSettings, Renderer, Result, TrainSettings};
pub use ashsplat_files::{CheckpointFile, Photo};
pub use glam::Vec3;
pub use tempfile::tempdir;

pub use super::device::{arena_peak, assert_silent, bounded, context, limited, options, with_range};
pub use super::engine::{camera, gaussians, loaded, renderer};
pub use super::gpu::Gpu;
pub use super::scenes::{Random, mixed_scene, rotation_about_y, small_scene, small_view};
pub use super::training::{EXTENT, Run, Succeeds, refusal, start, through_a_file, view_of, views};
pub use super::{assert_says, new_paths};
pub use crate::reference::types::{Extent, Gaussian, View};
