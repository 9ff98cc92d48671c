//! The Vulkan layer: everything that touches the device, and the only place with `unsafe`. Knows no splats.
//!
//! | module | what |
//! |---|---|
//! | `instance`, `device`, `create_device`, `context` | loader, devices and their choice, the open [`Context`] |
//! | `limits`, `workarounds` | [`Limits`], read once; stricter ones for tests; [`Workarounds`] by driver |
//! | `memory`, `buffer` | [`Context::allocate`]: requests packed into blocks; a [`Buffer`] is a named range of one |
//! | `kernel` | [`Kernel`]: a pipeline with the typed interface that build.rs generated |
//! | `pipeline_cache` | a host's VkPipelineCache, or one that is kept between runs |
//! | `allocator` | [`HostAllocator`]: memory from a host |
//! | `image`, `format` | [`Image`]: a host's or our own |
//! | `requirements`, `foreign`, `pool` | what a host enables; [`Context::from_foreign`], [`RecordSlot`] |
//! | `bind`, `descriptors` | binding for a dispatch; descriptor sets where push descriptors are missing |
//! | `recorder` | [`Recorder`]: dispatch, fill, copy, barrier, scope |
//! | `hazard` | finds missing barriers while recording |
//! | `submit` | [`Context::submit`], [`Pending`], [`RunReport`] |
//! | `transfer` | [`Context::upload`], [`Context::download`] |
//! | `budget`, `guards` | how much memory there may be; bands around buffers, for tests |
//! | `audit` | [`Context::audit`]: what every command wrote, as a hash |
//! | `faults` | for tests: calls that fail on demand |
//! | `profiler`, `debug` | time of each scope; names, labels and validation messages |
//! | `profile`, `clock` | [`Context::profile`]: every command with its grid, buffers and time, on the host's clock |
//!
//! # Ownership
//! A [`Context`] is a counted reference to the open device. Buffers, kernels, recorders and pending submissions hold
//! one, so the device outlives them all. A recorder also holds the memory and the pipelines of every command in it,
//! and hands them to its [`Pending`], which lets go once the device is done: dropping a buffer or a kernel is safe at
//! any time. Dropping a recorder discards the recording; dropping a pending submission waits for it.
//!
//! # Synchronisation
//! Inside a recording, commands may overlap until a [`Recorder::barrier`] stands between them. There is one kind,
//! compute and transfer to compute, transfer and indirect arguments, placed by hand where a stage needs it, like a
//! `__syncthreads` of the whole device. The hazard checker knows what each command reads and writes and panics, with
//! the names of both ends, where a barrier is missing. Between recordings nothing is needed: each begins with a full
//! barrier, and ends with one towards the host. The queue is guarded by a lock, so a context may be used from several
//! threads.
//!
//! Host access to memory that a submission uses is refused with an error until the submission has been waited for.
//!
//! # Subgroups
//! A kernel whose `Spec` has a `subgroup_size` runs with exactly that size and full subgroups;
//! [`Limits::subgroup_size`] says which to take, and [`Limits::workgroup_size`] which workgroup fits it.

#![allow(unsafe_code)]

mod allocator;
mod arenas;
mod audit;
mod bind;
mod binding;
mod binding_numbers;
mod budget;
mod buffer;
mod clock;
mod context;
mod create_device;
mod debug;
mod descriptors;
mod device;
mod faults;
mod foreign;
mod format;
mod guards;
pub mod hazard;
mod image;
mod instance;
mod kernel;
mod limits;
mod memory;
mod pipeline_cache;
mod pool;
mod profile;
mod profiler;
mod recorder;
mod requirements;
mod submit;
mod texels;
mod transfer;
mod workarounds;

pub use allocator::{HostAllocator, HostMemory, MemoryRequest};
pub use arenas::ArenaMemory;
pub use audit::{Audit, AuditRecord};
pub use binding::{Access, BindingInfo, BindingKind, ImageInfo};
pub use buffer::Buffer;
pub use context::{Context, ContextOptions};
pub use device::{DeviceDescription, devices};
pub use faults::{Fault, Faults};
pub use foreign::{ForeignCommands, ForeignDevice, RecordSlot};
pub use image::{ForeignImage, Image, ImageState, ImageUse};
pub use instance::validation_available;
pub use kernel::{ConstantInfo, ConstantKind, Form, Kernel, KernelInterface, KernelVisitor};
pub use limits::{Limits, LimitsOverride, SpecOverride, is_kernel_of, is_yardstick};
pub use memory::{MemoryKind, PLACEMENT_ALIGNMENT, Packing, SMALLEST_BUFFER, pack};
pub use pipeline_cache::{PipelineCacheData, PipelineCacheSink};
pub use profile::{BoundBuffer, CommandRecord, Profile, Submission};
pub use profiler::ScopeTime;
pub use recorder::{MAX_UPDATE_BYTES, Recorder};
pub use requirements::{Features, OptionalExtension, Requirements};
pub use submit::{Pending, RunReport};
pub use texels::TexelFormat;
pub use workarounds::Workarounds;

/// The error for a failed Vulkan call.
fn vk_error(call: &'static str) -> impl Fn(ash::vk::Result) -> crate::Error {
    use ash::vk::Result as R;
    move |result| {
        let remedy = match result {
            R::ERROR_DEVICE_LOST => return crate::Error::DeviceLost { call },
            R::ERROR_OUT_OF_DEVICE_MEMORY => "free device memory, or use a smaller scene or resolution",
            R::ERROR_OUT_OF_HOST_MEMORY => "free memory, or use a smaller scene or resolution",
            _ => "",
        };
        crate::Error::Vulkan { call, result: format!("{result:?} ({result})"), remedy: remedy.to_owned() }
    }
}
