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
//!  forward   cull → compact ──→ project → depth sort ──→ count → scan → expand → tile sort ──→ ranges → blend
//!  backward  adam ←──────────── project backward ←─ instances' sums ←─────────────────────────── blend backward ← loss
//!            densify: classify → scatter sources → gather
//! ```
//!
//! - [`Renderer`] and [`Trainer`] own their submissions: they record, submit, wait and read back.
//! - [`Renderer::record`] and [`Trainer::record_step`] record into a host engine's command buffer, on its device, with its
//!   images.
//! - [`forward`], [`backward`], [`loss`], [`exposure`], [`lens_effects`], [`optimizer`], [`densify`] only *record*, into a
//!   [`vk::Recorder`].
//! - [`sort`] and [`scan`] are usable alone, as is every kernel in [`kernels`]; [`arithmetic`] measures a device.
//! - [`lpips`] measures how different two pictures look, by the features of a neural network.
//! - [`scene`] knows no Vulkan; [`vk`] knows no splats and holds all of the `unsafe`.
//!
//! [`plan`] computes all sizes as pure arithmetic. Only the device knows how many Gaussians are visible and how many
//! instances they make. So dispatches over them are indirect, and buffers have capacities. A frame that needs more reports
//! it and is run again. The same inputs on the same device give the same bits, in training too.

pub mod arithmetic;
pub mod backward;
pub mod compose;
pub mod densify;
pub mod error;
pub mod exposure;
pub mod fingerprint;
pub mod forward;
pub mod guide;
pub mod kernels;
pub mod lens_effects;
pub mod loss;
pub mod lpips;
pub mod optimizer;
pub mod pixels;
pub mod plan;
pub mod planes;
pub mod poses;
pub mod renderer;
pub mod scan;
pub mod scene;
pub mod sort;
pub mod subgroups;
pub mod trainer;
pub mod tuning;
pub mod vk;

/// The Vulkan bindings whose types the API shows.
pub use ash;
pub use compose::Background;
pub use error::{Error, Result};
pub use forward::{Blending, Extent, JacobianLimit, RenderSettings, SceneSettings, Selection, Shape};
/// The vectors and matrices whose types the API shows.
pub use glam;
pub use renderer::{
    Alignment, BlendSamples, DepthTarget, DeviceScene, Frame, FrameStats, Gradients, HostImage, MotionTarget,
    Occluder, PickTarget, PixelReport, Placed, ProjectedSplat, RecordedFrame, Release, Renderer, Reservation,
    Sample, SlotReport, Target, TileLists, TileReport, Update,
};
pub use scene::{Camera, ColorEncoding, Gaussians};
pub use trainer::{Checkpoint, StepReport, TrainSettings, TrainView, Trainer};
