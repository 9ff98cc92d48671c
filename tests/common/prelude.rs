//! Types and fixtures that most tests of the engine use.

pub use ashsplat::train::{Checkpoint, StepReport, StrategyType, TrainView, Trainer};
pub use ashsplat::vk::{Buffer, Context, ContextOptions, LimitsOverride, MemoryKind, SpecOverride};
pub use ashsplat::{
    Camera, Error, Frame, Gaussians, RenderSettings, Renderer, Result, ShStorage, TrainSettings,
};
pub use ashsplat_files::{CheckpointFile, Photo};
pub use glam::Vec3;
pub use tempfile::tempdir;

pub use super::compare::{GradientTolerance, PixelTolerance, elementwise, equal, gradient, pixels, relative};
pub use super::device::{arena_peak, assert_silent, bounded, context, limited, options, with_range};
pub use super::engine::{camera, gaussians, loaded, renderer, widen};
pub use super::gpu::{Gpu, UNTOUCHED, sizes};
pub use super::layout::{
    antialias_word, camera_block, cut_outs, depth_of_key, extent_word, pack, pack_filtered, pack_splats,
    place, plane_capacity, plane_place, planes, scene_blocks, unpack,
};
pub use super::scenes::*;
pub use super::training::{EXTENT, Run, Succeeds, refusal, start, through_a_file, view_of, views};
pub use super::{assert_says, new_paths};
pub use crate::reference::types::{
    CutOut, Dropout, Extent, Gaussian, Gradient, Limits, Selection, Splat, SplatGradient, Style, Tint, View,
};
