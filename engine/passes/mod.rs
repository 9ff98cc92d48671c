//! The passes: each records its kernels into a [`vk::Recorder`](crate::vk::Recorder) and submits nothing. A pass begins
//! after a barrier and ends without one; whoever records two passes places the barrier between them. A pass that ends with a
//! barrier says so.
//!
//! `new` and `prepare` build kernels. Without a section on errors, they only fail when the device refuses a pipeline; uploads
//! and downloads, only when memory is short or the device is lost. `from_allocated` panics for another number of buffers than
//! `requests` returns.

pub mod adam;
pub(crate) mod appearance;
pub mod arithmetic;
pub mod backward;
pub(crate) mod blend;
pub mod compose;
pub(crate) mod cull;
pub mod densify;
pub mod filter_3d;
pub(crate) mod instances;
pub mod lens;
pub mod loss;
pub mod lpips;
pub mod pixels;
pub mod poses;
pub(crate) mod project;
pub mod scan;
pub mod sort;
