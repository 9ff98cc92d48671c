//! 3D Gaussian Splatting (Kerbl et al., SIGGRAPH 2023) on raw Vulkan compute: rendering, differentiation, training.
//!
//! The [`guide`] has a chapter for each task, with examples that compile:
//!
//! - [program](guide::program), [data sets](guide::data_sets), [formats](guide::formats), [viewer](guide::viewer)
//! - [first frame](guide::first_frame), [first training](guide::first_training), [parts](guide::parts)
//! - [masks and memory](guide::masks_and_memory), [checkpoints](guide::checkpoints), [blocks](guide::blocks), [tiles](guide::tiles)
//! - [measuring](guide::measuring), [profiling](guide::profiling)
//! - [determinism](guide::determinism), [faults](guide::faults)
//! - [how it works](guide::how_it_works), [embedding](guide::embedding), [colour](guide::colour)
//!
//! The crate `ashsplat-files` reads and writes files, photographs and data sets. The program is the crate `ashsplat-cli`,
//! the C interface `ashsplat-capi`.
//!
//! # Overview
//!
//! ```text
//!            per Gaussian        per visible              per (tile, Gaussian) instance          per tile, per pixel
//!  forward   cull → compact ──→ project → depth sort ──→ count → scan → duplicate → tile sort ──→ ranges → blend
//!  backward  adam ←──────────── project backward ←─ instances' sums ←─────────────────────────── blend backward ← loss
//!            densify: classify → scatter sources → gather
//! ```
//!
//! To find the way through the source, read [`render`] first, where a frame is a list of passes, then [`passes`], then `glsl/`.
//!
//! - [`render`]: [`Renderer::render`] records a frame, submits, waits and reads back. [`Renderer::record`] records into a host
//!   engine's command buffer, on its device, with its images.
//! - [`train`]: [`Trainer`], likewise with [`Trainer::record_step`]; schedules, density control, checkpoints.
//! - [`surface`]: meshes of scenes, from the depths of many views.
//! - [`passes`]: one module per pass, each only *records* into a [`vk::Recorder`]. [`passes::sort`] and [`passes::scan`] are
//!   usable alone, and [`passes::lpips`] measures how different two pictures look.
//! - [`frame`]: what passes share: buffers and their sizes, scenes, the camera block, settings.
//! - [`scene`]: Gaussians, cameras, photographs; it knows no Vulkan.
//! - [`vk`]: memory, commands, pipelines, barriers; it knows no splats and holds all of the `unsafe`.
//! - [`kernels`]: the typed interface of every shader, for those who want single kernels.
//!
//! All sizes are computed beforehand, as pure arithmetic. Only the device knows how many Gaussians are visible and how many
//! instances they make. So dispatches over them are indirect, and buffers have capacities. A frame that needs more reports
//! it and is run again. The same inputs on the same device give the same bits, in training too.

#![cfg_attr(test, allow(clippy::disallowed_methods, clippy::expect_used))]

pub mod error;
pub mod frame;
pub mod guide;
pub mod kernels;
pub mod passes;
pub mod render;
pub mod scene;
pub mod surface;
pub mod train;
pub mod vk;

/// The Vulkan bindings whose types the API shows.
pub use ash;
pub use error::{Error, Result};
pub use frame::{Blending, Extent, RenderSettings, SceneSettings, Selection, ShStorage, Shape, SurfaceDepth};
/// The vectors and matrices whose types the API shows.
pub use glam;
pub use passes::compose::Background;
pub use render::{
    Alignment, BlendSamples, DepthTarget, DeviceScene, Frame, FrameStats, Gradients, HostImage, MotionTarget,
    Occluder, PixelReport, Placed, RecordedFrame, Release, Renderer, Reservation, Sample, SlotReport,
    Surface, SurfaceTarget, Target, TileReport, Update,
};
pub use scene::{Camera, ColorEncoding, Gaussians, JacobianLimit};
pub use train::{Checkpoint, StepReport, TrainSettings, TrainView, Trainer};
