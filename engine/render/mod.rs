//! Rendering. [`Renderer::render`] records a frame, submits it, waits and reads it back. [`Renderer::record`] only records
//! into a host's command buffer.

mod align;
mod check;
mod device_scene;
mod forward;
mod frame;
mod frame_store;
mod gradients;
mod inspect;
mod record;
mod recorded_frame;
mod recording_lists;
mod renderer;
mod reservation;
mod reserve;
mod runner;
mod slots;
mod updates;

pub use align::Alignment;
pub use device_scene::DeviceScene;
pub use forward::Forward;
pub use frame::{BlendSamples, Frame, FrameStats, Surface};
pub(crate) use frame_store::{FrameCounts, FrameStore};
pub use gradients::Gradients;
pub use inspect::{PixelReport, Sample, TileReport};
pub use recorded_frame::{
    DepthTarget, HostImage, MotionTarget, Occluder, Placed, RecordedFrame, Release, SurfaceTarget, Target,
};
pub use renderer::Renderer;
pub use reservation::{Reservation, SlotReport};
pub(crate) use runner::{FrameRun, FrameRunner, Request, RunError, frozen_capacity};
pub use updates::Update;
