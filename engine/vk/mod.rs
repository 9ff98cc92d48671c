//! The Vulkan layer: everything that touches the device, and the only place with `unsafe`. It knows nothing of splats.
//!
//! From the bottom up: a file imports only files above it in this table.
//!
//! | module | what |
//! |---|---|
//! | `error`, `access`, `format`, `texels`, `clock`, `pool`, `arenas` | shared by all others |
//! | `limits`, `workarounds`, `requirements` | [`Limits`], read once; [`Workarounds`] by driver; features that a host
//! enables |
//! | `allocator` | [`MemoryKind`]; [`HostAllocator`]: memory from a host |
//! | `pipeline_cache` | a host's VkPipelineCache, or our own, kept between runs |
//! | `debug`, `raw_device` | names, labels and validation messages; the device's functions |
//! | `instance`, `device`, `create_device` | the loader, devices and their choice |
//! | `compile_only`, `executables` | a device that runs nothing; compiler statistics of a pipeline |
//! | `copy_queue` | a queue for copies beside the main one, and the semaphores between both |
//! | `open_device` | the open device; everything made from it keeps it open |
//! | `memory`, `buffer`, `allocate` | requests packed into blocks; a [`Buffer`] is a named range of one |
//! | `descriptors` | descriptor sets for devices without push descriptors |
//! | `profile`, `profiler`, `audit` | [`Context::profile`] and [`Context::audit`]: time and output of every command |
//! | `commands` | command buffers: recorded, submitted, waited for |
//! | `staging` | the ring of staging memory of uploads and downloads |
//! | `queues`, `queue_lock` | queue families; the lock of a queue, including a host's [`QueueLock`] |
//! | `context`, `open` | the open [`Context`]; [`Context::new`] and its options |
//! | `pipeline_statistics` | [`Context::pipeline_statistics`]: compiler statistics of all kernels |
//! | `budget` | [`Context::allocate`], and limits of memory |
//! | `image`, `adopt` | [`Image`]: a host's or our own; buffers of a host |
//! | `image_owner` | images that another queue family owns between recordings |
//! | `kernel`, `resources` | [`Kernel`]: a pipeline with the typed interface that build.rs generated; its resources |
//! | `pipeline` | the Vulkan pipeline, and its demands on the device |
//! | `kernel_job` | [`KernelJob`]: a kernel that any thread can build ahead |
//! | `hazard` | finds missing barriers while recording |
//! | `recorder` | [`Recorder`]: dispatch, fill, copy, barrier, scope |
//! | `bind`, `record_image`, `record_audit` | further parts of the recorder |
//! | `memory_rates` | [`Context::measure_memory`] |
//! | `submit`, `transfer` | [`Context::submit`], [`Pending`], [`RunReport`]; [`Context::upload`], [`Context::download`] |
//! | `foreign`, `slot_recording` | [`Context::from_foreign`], [`RecordSlot`], [`SlotRecording`] |
//! | `faults`, `failing_calls`, `guard_bands`, `guards`, `limits_override`, `record_testing` | with the feature `testing` |
//!
//! # Ownership
//! A [`Context`] is a counted reference to the open device. Buffers, kernels, recorders and pending submissions hold
//! one, so the device outlives them all. A recorder also holds the memory and the pipelines of its commands. It
//! passes them to its [`Pending`], which drops them once the device is done. So dropping a buffer or a kernel is safe
//! at any time. Dropping a recorder discards the recording; dropping a pending submission waits for it.
//!
//! # Synchronisation
//! Inside a recording, commands may overlap unless a [`Recorder::barrier`] separates them. There is one kind of barrier:
//! from compute and transfer to compute, transfer and indirect arguments. It is placed by hand where a stage needs it, like
//! a `__syncthreads` of the whole device. The hazard checker knows the reads and writes of each command. It panics, and
//! names both commands, if a barrier is missing. Between recordings no barrier is needed: each begins with a full barrier,
//! and ends with one towards the host. A lock guards the queue, so several threads may use a context.
//!
//! Host access to memory that a submission uses is an error until the submission has been waited for.
//!
//! # Subgroups
//! A kernel whose `Spec` has a `subgroup_size` runs with exactly that size and full subgroups. [`Limits::subgroup_size`]
//! and [`Limits::heavy_subgroup_size`] give the size, [`Limits::workgroup_size`] a workgroup that fits it.

#![allow(unsafe_code)]

mod allocate;
mod allocator;
mod arenas;
mod audit;
mod binding;
mod binding_numbers;
mod budget;
mod buffer;
mod built;
mod clock;
mod commands;
mod compile_only;
mod context;
mod debug;
mod declared;
mod descriptors;
mod device;
mod executables;
#[cfg(feature = "testing")]
mod failing_calls;
#[cfg(feature = "testing")]
mod faults;
mod foreign;
mod format;
#[cfg(feature = "testing")]
mod guard_bands;
#[cfg(feature = "testing")]
mod guards;
pub mod hazard;
mod held_queues;
mod image;
mod image_owner;
mod instance;
mod kernel;
mod kernel_set;
mod limits;
#[cfg(feature = "testing")]
mod limits_override;
mod memory;
mod memory_rates;
mod memory_types;
mod open;
mod open_device;
mod pipeline;
mod pipeline_cache;
mod pipeline_statistics;
mod profile;
mod queues;
mod raw_device;
mod record_audit;
#[cfg(feature = "testing")]
mod record_testing;
mod recorder;
mod requirements;
mod resources;
mod slot_recording;
mod spirv;
mod staging;
mod submit;
mod texels;
mod transfer;
mod workarounds;

pub use allocator::{HostAllocator, HostMemory, MemoryKind, MemoryRequest};
pub use arenas::ArenaMemory;
pub use audit::{Audit, AuditRecord};
pub use binding::{BindingInfo, BindingKind, ImageInfo};
pub use buffer::Buffer;
pub use context::Context;
pub use context::KernelJob;
pub use device::{DeviceDescription, devices};
pub use executables::{CompileOnly, Executable, Statistic};
#[cfg(feature = "testing")]
pub use faults::{Fault, Faults};
pub use foreign::{ForeignCommands, ForeignDevice, RecordSlot};
pub use format::{
    COLOR_FORMATS, DEPTH_FORMAT, HOST_DEPTH_FORMATS, ImageKind, ImageUse, MOTION_FORMAT, PICK_FORMAT,
};
pub use hazard::Access;
pub use held_queues::HeldQueues;
pub use image::{ForeignImage, Image, ImageState};
pub use instance::validation_available;
pub(crate) use kernel::sealed::Generated;
pub use kernel::{ConstantInfo, ConstantKind, Form, Kernel, KernelInterface, KernelVisitor};
pub use kernel_set::KernelSet;
pub use limits::{Limits, SpecOverride, is_kernel_of, is_yardstick};
#[cfg(feature = "testing")]
pub use limits_override::LimitsOverride;
pub use memory::{PLACEMENT_ALIGNMENT, Packing, SMALLEST_BUFFER, pack};
pub use memory_rates::{MemoryRates, Transfers};
pub use open::ContextOptions;
pub use open_device::QueueLock;
pub use pipeline_cache::{PipelineCacheKey, PipelineCacheStore};
pub use pipeline_statistics::PipelineStatistics;
pub use profile::{BoundBuffer, CommandRecord, Profile, ScopeTime, Submission};
pub use recorder::{MAX_UPDATE_BYTES, Recorder};
pub use requirements::{Features, OptionalExtension, OptionalFeature, Requirements};
pub use slot_recording::SlotRecording;
pub use submit::{Pending, RunReport};
pub use texels::TexelFormat;
pub use workarounds::Workarounds;
