//! The Vulkan layer: everything that touches the device, and the only place with `unsafe`. It knows nothing of splats.
//!
//! From the bottom up: a file imports only files above it in this table.
//!
//! | module | what |
//! |---|---|
//! | `binding_numbers`, `lock`, `format` | numbers of bindings; locks; formats and accesses |
//! | `limits`, `requirements` | [`Limits`], read once; features that a host enables |
//! | `debug` | names, labels and validation messages |
//! | `memory_types` | [`MemoryKind`] and its memory types; [`HostAllocator`]: memory from a host |
//! | `compile_only` | a device's functions that run nothing |
//! | `device`, `spirv` | the loader, devices and their choice; shaders as they need them |
//! | `pipeline_cache` | what identifies a pipeline; the pipelines of a device, and a VkPipelineCache kept between runs |
//! | `open_device`, `faults`, `failing_calls` | the open device; everything made from it keeps it open; its queues and their locks; calls that fail on demand |
//! | `memory` | requests packed into blocks; a [`Buffer`] is a named range of one |
//! | `pipeline` | the Vulkan pipeline, its demands on the device, descriptor sets; [`KernelJob`] |
//! | `profile`, `audit` | [`Context::profile`] and [`Context::audit`]: time and output of every command |
//! | `commands` | command buffers: recorded, submitted, waited for |
//! | `staging` | the ring of staging memory of uploads and downloads |
//! | `context` | the open [`Context`]; [`Context::new`] and its options, [`Context::from_foreign`] |
//! | `image` | [`Image`]: a host's or our own, and its owner |
//! | `kernel` | [`Kernel`]: a pipeline with the typed interface that build.rs generated |
//! | `barriers` | stages of the barriers of a recording |
//! | `hazard` | missing barriers of a recording |
//! | `recorder` | [`Recorder`]: dispatch, fill, copy, barrier, scope |
//! | `submit` | [`Context::submit`], [`Pending`], [`RunReport`]; [`Context::upload`], [`Context::download`] |
//! | `budget` | [`Context::allocate`], limits of memory, and [`Context::measure_memory`] |
//! | `foreign` | [`Context::adopt_commands`], [`Buffer::adopt`], [`RecordSlot`], [`SlotRecording`] |
//!
//! # Ownership
//! A [`Context`] is a counted reference to the open device. Buffers, kernels, recorders and pending submissions hold
//! one, so the device outlives them all. A recorder also holds the memory and the pipelines of its commands. It
//! passes them to its [`Pending`], which drops them once the device is done. So dropping a buffer or a kernel is safe
//! at any time. Dropping a recorder discards the recording; dropping a pending submission waits for it.
//!
//! # Synchronisation
//! Inside a recording, commands may overlap unless a [`Recorder::barrier`] separates them. There is one kind of barrier.
//! It is placed by hand where a stage needs it, like a `__syncthreads` of the whole device; the recorder finds the stages
//! that wait. The hazard checker knows the reads and writes of each command. It panics, and
//! names both commands, if a barrier is missing. Between recordings no barrier is needed: each begins with a full barrier,
//! and ends with one towards the host. A lock guards the queue, so several threads may use a context.
//!
//! Host access to memory that a submission uses is an error until the submission has been waited for.
//!
//! # Subgroups
//! A kernel whose `Spec` has a `subgroup_size` runs with exactly that size and full subgroups. [`Limits::subgroup_size`]
//! and [`Limits::heavy_subgroup_size`] give the size, [`Limits::workgroup_size`] a workgroup that fits it.
//!
//! # Errors
//! Unless a function names other errors, they are the driver's: it has no memory left, or the device is lost.

#![allow(unsafe_code)]

mod audit;
mod barriers;
mod binding_numbers;
mod budget;
mod commands;
mod compile_only;
mod context;
mod debug;
mod device;
#[cfg(feature = "testing")]
mod failing_calls;
#[cfg(feature = "testing")]
mod faults;
mod foreign;
mod format;
mod hazard;
mod image;
mod kernel;
mod limits;
mod lock;
mod memory;
mod memory_types;
mod open_device;
mod pipeline;
mod pipeline_cache;
mod profile;
mod recorder;
mod requirements;
mod spirv;
mod staging;
mod submit;

pub use audit::{Audit, AuditRecord};
pub use budget::{MemoryRates, Transfers};
pub use compile_only::{CompileOnly, Executable, Statistic};
pub use context::{Context, ContextOptions, ForeignDevice};
pub use device::{DeviceDescription, devices, validation_available};
#[cfg(feature = "testing")]
pub use faults::{Fault, Faults};
pub use foreign::{ForeignCommands, RecordSlot, SlotRecording};
pub use format::{
    Access, COLOR_FORMATS, DEPTH_FORMAT, HOST_DEPTH_FORMATS, ImageKind, ImageUse, MOTION_FORMAT, PICK_FORMAT,
    SURFACE_FORMATS, TexelFormat,
};
pub use image::{ForeignImage, Image, ImageState};
pub(crate) use kernel::sealed::Generated;
pub use kernel::{
    ConstantInfo, ConstantKind, Form, Kernel, KernelInterface, KernelSet, KernelVisitor, PipelineStatistics,
};
#[cfg(feature = "testing")]
pub use limits::LimitsOverride;
pub use limits::{Limits, SpecOverride, is_kernel_of, is_yardstick};
pub use memory::{Buffer, Life, PLACEMENT_ALIGNMENT, Packing, SMALLEST_BUFFER, pack};
pub use memory_types::{ArenaMemory, HostAllocator, HostMemory, MemoryKind, MemoryRequest};
pub use open_device::QueueLock;
pub use pipeline::KernelJob;
pub use pipeline_cache::{BindingInfo, BindingKind, ImageInfo, PipelineCacheKey, PipelineCacheStore};
pub use profile::{BoundBuffer, CommandRecord, Profile, ScopeTime, Submission};
pub use recorder::{MAX_UPDATE_BYTES, Recorder};
pub use requirements::{Features, Optional, Requirements};
pub use submit::{Pending, RunReport};
