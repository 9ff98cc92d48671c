//! Opens a device: the options, and the context of our own device or of a host's.

use super::audit::{self, Audit};
use super::binding_numbers::BUFFERS;
use super::commands::Pools;
use super::compile_only::{self, CompileOnly, Executables};
use super::debug::{Names, vk_error};
use super::device::{self, Candidate, DeviceDescription, Instance, has_extension};
#[cfg(feature = "testing")]
use super::faults::Faults;
#[cfg(feature = "testing")]
use super::limits::LimitsOverride;
use super::limits::{Limits, SpecOverride};
use super::lock::lock;
#[cfg(feature = "testing")]
use super::memory::Block;
use super::memory::UNBOUNDED;
use super::memory_types::{HostAllocator, Location, Registry};
use super::open_device::RawDevice;
use super::open_device::{CopyQueue, Device, Owner, QueueLock};
use super::pipeline::{Jobs, add_shared_layouts};
use super::pipeline_cache::{BuiltPipelines, PipelineCache, PipelineCacheStore};
use super::profile;
use super::profile::Profile;
use super::requirements::{Features, Requirements};
use super::spirv::{Reconvergence, SubgroupRules};
use super::staging::Ring;
use crate::error::{Error, Result};
use crate::frame::tuning::{Backend, Tuning};
use ash::vk;
use std::ffi::CStr;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, Weak};
use std::time::Duration;

/// An open device with its queue. Cheap to clone; buffers, kernels and recordings keep it open. See the
/// [guide](crate::guide::first_frame).
#[derive(Clone)]
pub struct Context {
    pub(super) device: Arc<Device>,
    pub(super) pools: Arc<Pools>,
    pub(super) logs: Arc<Logs>,
    /// Staging memory of transfers, if device memory is not mapped.
    pub(super) staging: Arc<Mutex<Ring>>,
    /// If present, kernels are added to this list instead of being built.
    pub(super) jobs: Option<Jobs>,
}

#[derive(Default)]
pub(super) struct Logs {
    /// The profile that records every command, if one exists.
    pub(super) profile: Mutex<Weak<profile::Log>>,
    /// The audit that hashes the output of every command, if one exists.
    pub(super) audit: Mutex<Weak<audit::Log>>,
    #[cfg(feature = "testing")]
    pub(super) guarded: Mutex<Vec<Weak<Block>>>,
}

impl Context {
    /// Returns the device's limits, as changed by the options.
    pub fn limits(&self) -> &Limits {
        &self.device.limits
    }

    pub(crate) fn owns_device(&self) -> bool {
        !self.device.is_foreign()
    }

    /// Set after the check of [`crate::frame::subgroups`] has passed.
    pub(crate) fn subgroups_are_sound(&self) -> &AtomicBool {
        &self.device.subgroups_are_sound
    }

    /// True if submissions run: a host may keep its queue to itself, and a compile-only device runs nothing.
    pub(crate) fn can_run(&self) -> bool {
        self.device.queue.is_some() && self.device.executables.is_none()
    }

    /// Returns the device's name, as the driver reports it.
    pub fn device_name(&self) -> &str {
        &self.device.description.name
    }

    /// Returns the driver's description of the device. Its limits are not changed by the options.
    pub fn description(&self) -> &DeviceDescription {
        &self.device.description
    }

    /// True if the queue can also draw (VK_QUEUE_GRAPHICS_BIT). Copying depth images requires this.
    pub fn draws(&self) -> bool {
        let families = self.device.queue_families();
        let own = families.get(self.device.queue_family as usize);
        own.is_some_and(|family| family.queue_flags.contains(vk::QueueFlags::GRAPHICS))
    }

    /// Returns all warnings and errors of the validation layers so far. Empty without
    /// [`ContextOptions::validation`](super::ContextOptions::validation).
    pub fn validation_messages(&self) -> Vec<String> {
        self.device.owner.messages().map_or_else(Vec::new, |messages| messages.all())
    }

    /// True if the device is lost, which makes this context unusable.
    pub fn is_lost(&self) -> bool {
        self.device.lost.load(Ordering::Relaxed)
    }

    /// Drops this handle. If it was the last owner of the device, destroys the device and returns all messages of the
    /// validation layers, including leaks.
    pub fn close(self) -> Option<Vec<String>> {
        let Self { device, pools, logs, staging, jobs } = self;
        drop((jobs, staging, pools, logs));
        let messages = device.owner.messages().cloned();
        drop(Arc::into_inner(device)?);
        Some(messages.map_or_else(Vec::new, |messages| messages.all()))
    }

    /// Returns what shaders printed since the last call. Empty without
    /// [`ContextOptions::debug_printf`](super::ContextOptions::debug_printf).
    pub fn printed(&self) -> Vec<String> {
        self.device.owner.messages().map_or_else(Vec::new, |messages| messages.take_printed())
    }

    /// Runs `work` between the two queue labels by which RenderDoc's layer begins and ends a capture. Without a window
    /// there are no frames that the layer could detect. Without such a layer the labels have no effect.
    ///
    /// # Errors
    /// [`Error::MissingFeature`] without VK_EXT_debug_utils and [`Error::Argument`] without a queue, both before any work.
    /// Errors of `work`, after the capture has ended.
    pub fn capture<T>(&self, work: impl FnOnce() -> Result<T>) -> Result<T> {
        let insert = |label| {
            let locked = self.device.lock_queue()?;
            Ok(self.device.names.insert_queue_label(*locked.queue, label))
        };
        if !insert("capture-marker,begin_capture")? {
            let device = self.device_name().to_owned();
            return Err(Error::MissingFeature { device, feature: "VK_EXT_debug_utils".to_owned() });
        }
        let result = work();
        insert("capture-marker,end_capture")?;
        result
    }

    /// Profiles every submission from now on, until the profile is dropped. A newer profile replaces an older one.
    pub fn profile(&self) -> Profile {
        let profile = Profile { log: Arc::default() };
        self.set_profile(Some(&profile));
        profile
    }

    /// Pauses or resumes profiles: only the given one records.
    pub fn set_profile(&self, profile: Option<&Profile>) {
        let log = profile.map_or_else(Weak::new, |profile| Arc::downgrade(&profile.log));
        *lock(&self.logs.profile) = log;
    }

    /// Turns timestamps off or on. Without them scopes are only labelled.
    pub fn set_timestamps(&self, on: bool) {
        self.device.timestamps.store(on, Ordering::Relaxed);
    }

    /// True if the device has timestamps.
    pub fn has_timestamps(&self) -> bool {
        self.device.timestamp_bits > 0
    }

    /// Locks the queues of a context of our own until the result is dropped. The host can then submit, present or wait for
    /// the whole device, while the program's other threads, which upload or render, wait. The holder must not call anything
    /// that submits: it would deadlock.
    ///
    /// # Errors
    /// [`Error::Argument`](crate::Error::Argument) if a host keeps its queue.
    pub fn hold_queues(&self) -> Result<impl Sized> {
        // Only this function takes both locks, so their order cannot deadlock.
        let main = self.device.lock_queue()?;
        Ok((main, self.device.copying.as_ref().map(|copies| copies.lock())))
    }

    /// Hashes the outputs of all following commands, until the audit is dropped.
    pub fn audit(&self) -> Audit {
        let log = Arc::<audit::Log>::default();
        *lock(&self.logs.audit) = Arc::downgrade(&log);
        Audit { log }
    }
}

/// Options for opening a device.
#[derive(Clone, Debug)]
pub struct ContextOptions {
    /// Index of the device or part of its name. None: the environment variable `ASHSPLAT_DEVICE`, or
    /// otherwise the best device.
    pub device: Option<String>,
    /// Turn on the Khronos validation layer with synchronization validation. It is an error if the layer is not installed.
    /// Layers of 2023 have a device table without a lock: open and close such devices only while no other thread uses a
    /// device.
    pub validation: bool,
    /// Panic if a recording lacks a barrier. Default: true in debug builds.
    pub hazard_check: bool,
    /// Time scopes if the device can. Default: true.
    pub timestamps: bool,
    /// Subgroup size of all kernels, if the device supports the choice. None:
    /// [`Tuning::lanes`](crate::frame::tuning::Tuning::lanes) and [`Tuning::heavy_lanes`](crate::frame::tuning::Tuning::heavy_lanes), or
    /// the device's default.
    pub subgroup_size: Option<u32>,
    /// Use the kernels, sizes and layouts of this class of devices ([`Tuning`]) on any device. None: the environment
    /// variable `ASHSPLAT_BACKEND` (`gpu` or `processor`), or the device's own class.
    pub backend: Option<Backend>,
    /// For tests: stricter limits than the device's.
    #[cfg(feature = "testing")]
    pub limits_override: Option<LimitsOverride>,
    /// Turn on the validation layer for `debugPrintfEXT` in shaders; [`Context::printed`] returns the output.
    /// It is an error if the layer is not installed.
    pub debug_printf: bool,
    /// Overrides of specialization constants.
    pub overrides: Vec<SpecOverride>,
    /// For tests: transfer through staging memory, as on a discrete GPU, even if device memory can be mapped.
    #[cfg(feature = "testing")]
    pub force_staging: bool,
    /// For tests: treat device memory as not cached by the host.
    #[cfg(feature = "testing")]
    pub force_uncached: bool,
    /// For a capture by RenderDoc: accept Vulkan 1.2. RenderDoc's layer reports 1.2 for every driver without
    /// bufferDeviceAddressCaptureReplay, such as llvmpipe, but passes 1.3 through.
    pub capture: bool,
    /// Longest wait for a submission; a longer one is an error. None: no limit. The driver resets a device that hangs, and
    /// reports it.
    pub timeout: Option<Duration>,
    /// Most bytes of device and staging memory, all arenas together. None: the device's memory.
    pub max_memory: Option<u64>,
    /// Train scenes that are larger than device memory. Parameters, moments and the target of densification are in host
    /// memory, at most this many bytes. Kernels reach them over the bus, for the Gaussians that they need. Results have the
    /// same bits. Default: None, everything is in device memory.
    pub offload: Option<u64>,
    /// For tests: guard bands around every buffer that detect writes outside it; see [`Context::breached_guards`].
    #[cfg(feature = "testing")]
    pub guard_bands: bool,
    /// For tests: Vulkan calls that fail on demand.
    #[cfg(feature = "testing")]
    pub faults: Option<Faults>,
    /// Compile kernels, but run nothing. Memory is host memory that begins as zeros, commands are dropped, and results are
    /// the contents of that memory. For [`Context::pipeline_statistics`], also on drivers without hardware. It is an error
    /// if the device lacks VK_KHR_pipeline_executable_properties. Default: None, everything runs.
    pub compile_only: Option<CompileOnly>,
    /// Write a card's memory directly if the host sees all of it (resizable BAR), not by copies. Reads still use copies.
    /// Default: true; never on a host's device. `ashsplat devices --measure` shows the rates of both.
    pub direct_writes: bool,
    /// Use VK_KHR_push_descriptor if the device has it. Default: true.
    pub push_descriptors: bool,
    /// Let kernels read buffers as texels on processors, where that is faster. The views are made while recording, so a
    /// host's buffers and command buffers cannot be adopted then. Default: true; never on a host's device.
    pub texels: bool,
    /// Further instance extensions, for a host that shares the device ([`Context::handles`]); for example, those of a
    /// window's surface.
    pub instance_extensions: Vec<&'static CStr>,
    /// Further device extensions, for such a host; for example, VK_KHR_swapchain.
    pub device_extensions: Vec<&'static CStr>,
    /// Build kernels with a VkPipelineCache that is kept between runs. Default: none. For a host's device see
    /// [`ForeignDevice::pipeline_cache`](super::ForeignDevice::pipeline_cache).
    pub pipeline_cache: Option<Arc<dyn PipelineCacheStore>>,
}

impl ContextOptions {
    /// Returns the requested class of devices: [`ContextOptions::backend`], or the environment variable `ASHSPLAT_BACKEND`.
    ///
    /// # Errors
    /// [`Error::Argument`] when the variable has another value.
    pub fn asked_backend(&self) -> Result<Option<Backend>> {
        if self.backend.is_some() {
            return Ok(self.backend);
        }
        let named = std::env::var_os("ASHSPLAT_BACKEND").filter(|name| !name.is_empty());
        let parsed = named.map(|name| name.to_string_lossy().parse());
        parsed.transpose().map_err(|problem: String| Error::argument("ASHSPLAT_BACKEND", problem))
    }
}

impl Default for ContextOptions {
    fn default() -> Self {
        Self {
            device: None,
            validation: false,
            hazard_check: cfg!(debug_assertions),
            timestamps: true,
            subgroup_size: None,
            backend: None,
            #[cfg(feature = "testing")]
            limits_override: None,
            debug_printf: false,
            overrides: Vec::new(),
            #[cfg(feature = "testing")]
            force_staging: false,
            #[cfg(feature = "testing")]
            force_uncached: false,
            capture: false,
            timeout: None,
            max_memory: None,
            offload: None,
            #[cfg(feature = "testing")]
            guard_bands: false,
            #[cfg(feature = "testing")]
            faults: None,
            compile_only: None,
            direct_writes: true,
            push_descriptors: true,
            texels: true,
            instance_extensions: Vec::new(),
            device_extensions: Vec::new(),
            pipeline_cache: None,
        }
    }
}

/// A host's device, and the features enabled at its creation.
#[derive(Clone)]
pub struct ForeignDevice<'a> {
    /// The instance with its functions.
    pub instance: &'a ash::Instance,
    /// The physical device.
    pub physical_device: vk::PhysicalDevice,
    /// The device with its functions.
    pub device: &'a ash::Device,
    /// Family of the queues to which recordings are submitted.
    pub queue_family: u32,
    /// Queue of that family for operations that submit and wait themselves: [`Context::run`], [`Context::upload`],
    /// [`crate::Renderer::render`]. None: these are refused, and only recording works.
    pub queue: Option<vk::Queue>,
    /// The host's lock of that queue. `None` if no other thread submits to it during such an operation.
    pub queue_lock: Option<Arc<dyn QueueLock>>,
    /// Features enabled at the device's creation: see [`Features::of`]. Optional ones that are not set are not used.
    pub features: Features,
    /// Device extensions enabled at its creation.
    pub extensions: &'a [&'a CStr],
    /// True if the instance was created with VK_EXT_debug_utils.
    pub debug_utils: bool,
    /// Allocator of the buffers' memory. None: the device itself.
    pub allocator: Option<Arc<dyn HostAllocator>>,
    /// The host's pipeline cache; null: none. The host keeps and destroys it.
    pub pipeline_cache: vk::PipelineCache,
}

impl Context {
    /// Opens a device.
    ///
    /// # Errors
    /// [`Error::NoLoader`], [`Error::NoDevice`], [`Error::UnknownDevice`]. [`Error::MissingFeature`], also for the
    /// validation layer and further extensions. [`Error::Argument`] for a subgroup size that the device does not have.
    pub fn new(options: &ContextOptions) -> Result<Self> {
        let instance = Instance::new(options.validation, options.debug_printf, &options.instance_extensions)?;
        let from_environment = std::env::var("ASHSPLAT_DEVICE").ok().filter(|d| !d.trim().is_empty());
        let requested = options.device.clone().or(from_environment);
        let min_version = if options.capture { vk::API_VERSION_1_2 } else { vk::API_VERSION_1_3 };
        let mut candidate = device::choose(&instance.raw, requested.as_deref(), min_version)?;
        candidate.features.push_descriptor &= options.push_descriptors;
        if options.device_extensions.contains(&ash::khr::swapchain::NAME) {
            candidate.queue_family = candidate.presenting_family;
        }
        if candidate.has_unified_memory() || options.compile_only.is_some() {
            // Host-visible memory is written directly, without copies.
            candidate.copying_family = None;
        }
        candidate.features.reconverges &= instance.knows_reconvergence();
        candidate.features.uniform_control_flow &= !candidate.features.reconverges;
        let mut limits = effective_limits(&candidate, options)?;
        if options.compile_only.is_some() {
            // A compile-only device has no times and no budget.
            candidate.features.memory_budget = false;
            limits.heap_bytes = compile_only::memory_properties().memory_heaps[0].size;
        }
        let raw = create_device(&instance.raw, &candidate, options)?;
        let raw = match options.compile_only {
            // SAFETY: the device is of this instance.
            Some(_) => unsafe { compile_only::table(&instance.raw, &raw) },
            None => raw,
        };
        let device = RawDevice::new(raw, true);
        // SAFETY: the device was created with one queue of this family.
        let queue = unsafe { device.get_device_queue(candidate.queue_family, 0) };
        let context =
            Self::assemble((candidate, limits), Owner::Us(instance), (device, Some(queue)), None, options)?;
        context.device.names.name(queue, "ashsplat queue");
        Ok(context)
    }

    /// Creates a context on a host's device. It never destroys objects of the host: dropping it destroys only its own. Only
    /// operations that submit wait for a queue, and only for the given one. After [`Error::Timeout`] a thread waits for the
    /// late submission: device and queue must live until it has finished.
    ///
    /// `options` has the same meaning as for [`Context::new`], except for the choice of the device and the
    /// layers, which are the host's.
    ///
    /// # Errors
    /// [`Error::MissingFeature`] with all of [`Context::requirements`] that the device lacks or the host has not enabled.
    /// [`Error::Argument`] for a null handle, a queue family without compute, or [`ContextOptions::compile_only`], which
    /// needs a device of our own.
    ///
    /// # Safety
    /// - `instance` and `device` are alive, were created for Vulkan 1.3 or later, and outlive the context and
    ///   everything made from it;
    /// - `device` was created from `physical_device`, with queues of `queue_family`;
    /// - `features` and `extensions` were enabled at its creation, and VK_EXT_debug_utils if `debug_utils` is set;
    /// - `queue`, if given, belongs to `device` and that family. During a call that submits, others use it only under
    ///   `queue_lock`, or not at all;
    /// - `device` was created with robustBufferAccess, or the push constants of all dispatches
    ///   ([`Recorder::dispatch`](super::Recorder::dispatch)) and the counts given to stages ([`crate::passes::scan`],
    ///   [`crate::passes::sort`], …) fit their buffers. Renderer and trainer see to that themselves;
    /// - the memory from `allocator` is memory of `device`;
    /// - `pipeline_cache`, if it is not null, is of `device`, was created without EXTERNALLY_SYNCHRONIZED, and
    ///   outlives the context.
    pub unsafe fn from_foreign(host: &ForeignDevice<'_>, options: &ContextOptions) -> Result<Self> {
        let null = [
            ("instance", host.instance.handle() == vk::Instance::null()),
            ("physical_device", host.physical_device == vk::PhysicalDevice::null()),
            ("device", host.device.handle() == vk::Device::null()),
            ("queue", host.queue == Some(vk::Queue::null())),
        ];
        if let Some((what, _)) = null.into_iter().find(|(_, null)| *null) {
            return Err(Error::argument(what, "the handle is null"));
        }
        if options.compile_only.is_some() {
            return Err(Error::argument("compile_only", "takes a device of its own: use Context::new"));
        }
        let mut candidate = device::describe(host.instance, 0, host.physical_device, vk::API_VERSION_1_3)?;
        if let Some(feature) = candidate.lacks(&host.features) {
            return Err(Error::MissingFeature { device: candidate.description.name.clone(), feature });
        }
        let families = device::queue_families(host.instance, host.physical_device);
        let family = families.get(host.queue_family as usize).copied().unwrap_or_default();
        if !family.queue_flags.contains(vk::QueueFlags::COMPUTE) {
            let problem = format!("family {} of the device has no compute", host.queue_family);
            return Err(Error::argument("queue_family", problem));
        }
        candidate.queue_family = host.queue_family;
        candidate.features.push_descriptor &=
            options.push_descriptors && host.extensions.contains(&ash::khr::push_descriptor::NAME);
        candidate.features.keep_enabled(&host.features, host.extensions);
        let limits = effective_limits(&candidate, options)?;
        let owner = Owner::Host(host.instance.clone());
        let device = RawDevice::new(host.device.clone(), false);
        Self::assemble((candidate, limits), owner, (device, host.queue), Some(host), options)
    }

    /// Assembles a context from a device that fulfils the requirements. On failure it destroys a device of our own.
    fn assemble(
        (candidate, mut limits): (Candidate, Limits),
        owner: Owner,
        (device, queue): (RawDevice, Option<vk::Queue>),
        host: Option<&ForeignDevice<'_>>,
        options: &ContextOptions,
    ) -> Result<Self> {
        let (instance, features) = (owner.instance(), candidate.features);
        // SAFETY: the physical device is of this instance.
        let (mut memory, properties) = unsafe {
            (
                instance.get_physical_device_memory_properties(candidate.physical),
                instance.get_physical_device_properties(candidate.physical),
            )
        };
        let families = device::queue_families(instance, candidate.physical);
        let family = families.get(candidate.queue_family as usize).copied().unwrap_or_default();
        let foreign = host.is_some();
        if foreign || !features.push_descriptor || !options.texels || !features.int64 {
            // Buffer views are made while recording, and a host's buffers may lack the usage. Kernels that read texels
            // write 64-bit integers.
            limits.max_texels = 0;
        }
        limits.broadcasts = limits.tuning.broadcasts && features.dynamic_broadcasts;
        if !features.push_descriptor {
            limits.max_push_descriptors = BUFFERS;
        }
        let runs = options.compile_only.is_none();
        let debug_utils = match &owner {
            Owner::Us(instance) => instance.has_debug_utils && runs,
            Owner::Host(_) => host.is_some_and(|host| host.debug_utils),
        };
        if !runs {
            memory = compile_only::memory_properties();
        }
        let location = match candidate.has_unified_memory() || !runs {
            true => Location::Unified,
            false if foreign || !options.direct_writes => Location::Card,
            false => Location::of_card(&memory),
        };
        // From here on, dropping `open` destroys everything created so far.
        let mut open = Device {
            push_descriptor: features.push_descriptor.then(|| match runs {
                true => ash::khr::push_descriptor::Device::new(instance, &device),
                false => compile_only::push_descriptor(&device),
            }),
            executables: options.compile_only.map(|requested| Executables::new(instance, &device, requested)),
            shared_layouts: None,
            names: Names::new(instance, &device, debug_utils),
            device,
            queue: queue.map(Mutex::new),
            queue_lock: host.and_then(|host| host.queue_lock.clone()),
            queue_family: candidate.queue_family,
            copying: None,
            physical: candidate.physical,
            subgroup_rules: SubgroupRules {
                fixed_size: !limits.subgroup_size_selectable,
                reconvergence: Reconvergence::of(&features),
                broadcasts: features.dynamic_broadcasts,
            },
            limits,
            memory,
            location,
            force_uncached: false,
            timestamp_bits: if options.timestamps && runs { family.timestamp_valid_bits } else { 0 },
            timestamps: AtomicBool::new(true),
            hazard_check: options.hazard_check,
            timeout: options.timeout,
            max_memory: AtomicU64::new(options.max_memory.unwrap_or(UNBOUNDED)),
            offload: AtomicU64::new(options.offload.unwrap_or(0)),
            guard_bands: false,
            budget: features.memory_budget.then_some(candidate.physical),
            lost: AtomicBool::new(false),
            description: candidate.description,
            registry: Registry::default(),
            replaced: Mutex::default(),
            built: BuiltPipelines::default(),
            subgroups_are_sound: AtomicBool::new(false),
            allocator: host.and_then(|host| host.allocator.clone()),
            pipeline_cache: PipelineCache::of_host(
                host.map_or_else(vk::PipelineCache::null, |host| host.pipeline_cache),
            ),
            owner,
        };
        #[cfg(feature = "testing")]
        {
            open.device.faults.clone_from(&options.faults);
            open.location = if options.force_staging { Location::Card } else { open.location };
            (open.force_uncached, open.guard_bands) = (options.force_uncached, options.guard_bands);
        }
        if let (Some(family), false) = (candidate.copying_family, foreign) {
            open.copying = Some(CopyQueue::new(&open.device, family)?);
        }
        if !features.push_descriptor {
            add_shared_layouts(&mut open)?;
        }
        if let (Some(store), false) = (&options.pipeline_cache, foreign || !runs) {
            open.pipeline_cache = PipelineCache::of_store(&open.device, &properties, store.clone())?;
        }
        let device = Arc::new(open);
        let pools = Arc::new(Pools::new(device.clone()));
        Ok(Self { pools, logs: Arc::default(), staging: Arc::default(), jobs: None, device })
    }
}

fn effective_limits(candidate: &Candidate, options: &ContextOptions) -> Result<Limits> {
    let device = &candidate.description;
    let Some(limits) = device.limits.clone() else {
        return Err(Error::MissingFeature { device: device.name.clone(), feature: "Vulkan 1.3".into() });
    };
    #[cfg(feature = "testing")]
    let limits = limits.lowered(&options.limits_override.unwrap_or_default());
    let mut limits = limits;
    if let Some(backend) = options.asked_backend()?
        && backend != limits.tuning.backend
    {
        limits = limits.tuned(Tuning::of(backend));
    }
    limits.overrides.clone_from(&options.overrides);
    if let Some(size) = options.subgroup_size {
        let (min, max) = (limits.min_subgroup_size, limits.max_subgroup_size);
        let selectable = limits.subgroup_size_selectable && (min..=max).contains(&size);
        if size != limits.subgroup_size && !(selectable && size.is_power_of_two()) {
            let has = match limits.subgroup_size_selectable {
                true => format!("'{}' has powers of two from {min} to {max}", device.name),
                false => format!("'{}' has only {}", device.name, limits.subgroup_size),
            };
            return Err(Error::argument(format!("subgroup size {size}"), has));
        }
        (limits.subgroup_size, limits.heavy_subgroup_size) = (size, size);
    }
    if !(4..=128).contains(&limits.heavy_subgroup_size) || limits.subgroup_size > 128 {
        let problem =
            format!("the kernels take 4 to 128; '{}' was to run {}", device.name, limits.subgroup_size);
        return Err(Error::argument("subgroup size", problem));
    }
    let largest = limits.subgroup_size.max(limits.heavy_subgroup_size);
    let (needed, has) = (Requirements::workgroup_invocations(largest), limits.max_workgroup_invocations);
    // Workgroups below the required minimum occur only in tests; small subgroups still fit them.
    if needed > Requirements::workgroup_invocations(1) && has < needed {
        let problem = format!("takes workgroups of {needed} invocations; '{}' has {has}", device.name);
        return Err(Error::argument(format!("subgroup size {largest}"), problem));
    }
    Ok(limits)
}

/// Creates a device with the required features, its optional features, and the extensions that the options ask for. It has a
/// main queue, and a copy queue if there is a family for copies.
fn create_device(
    instance: &ash::Instance,
    candidate: &Candidate,
    options: &ContextOptions,
) -> Result<ash::Device> {
    let optional = &candidate.features;
    let statistics = options.compile_only.is_some();
    let mut v12 = optional
        .v12
        .subgroup_broadcast_dynamic_id(optional.dynamic_broadcasts)
        // Every device of Vulkan 1.2 has it.
        .timeline_semaphore(candidate.copying_family.is_some());
    let mut v13 = vk::PhysicalDeviceVulkan13Features::default();
    Features::REQUIRED.merge_into(&mut v12, &mut v13);
    let used = [
        (statistics, ash::khr::pipeline_executable_properties::NAME),
        (optional.push_descriptor, ash::khr::push_descriptor::NAME),
        (optional.portability_subset, ash::khr::portability_subset::NAME),
        (optional.memory_budget, ash::ext::memory_budget::NAME),
        (optional.robust_buffers2, ash::ext::robustness2::NAME),
        (optional.reconverges, ash::khr::shader_maximal_reconvergence::NAME),
        (optional.uniform_control_flow, ash::khr::shader_subgroup_uniform_control_flow::NAME),
    ];
    let used = used.into_iter().filter_map(|(is_used, name)| is_used.then_some(name));
    let names: Vec<&CStr> = options.device_extensions.iter().copied().chain(used).collect();
    // SAFETY: a plain query.
    let present = unsafe { instance.enumerate_device_extension_properties(candidate.physical) };
    let present = present.map_err(vk_error("vkEnumerateDeviceExtensionProperties"))?;
    if let Some(lacking) = names.iter().find(|name| !has_extension(&present, name)) {
        let feature = lacking.to_string_lossy().into_owned();
        return Err(Error::MissingFeature { device: candidate.description.name.clone(), feature });
    }
    let extensions: Vec<_> = names.iter().map(|name| name.as_ptr()).collect();
    let priorities = [1.0];
    let families = std::iter::once(candidate.queue_family).chain(candidate.copying_family);
    let queue = |family| {
        vk::DeviceQueueCreateInfo::default().queue_family_index(family).queue_priorities(&priorities)
    };
    let queues: Vec<_> = families.map(queue).collect();
    // Without these features the layer refuses to print.
    let printing = options.debug_printf && optional.graphics_stores;
    // Every device has robustBufferAccess. It is needed because counts in push constants are not checked here.
    let core = vk::PhysicalDeviceFeatures::default()
        .robust_buffer_access(true)
        .shader_int64(optional.int64)
        .fragment_stores_and_atomics(printing)
        .vertex_pipeline_stores_and_atomics(printing);
    let mut robustness2 = vk::PhysicalDeviceRobustness2FeaturesEXT::default().robust_buffer_access2(true);
    let mut info = vk::DeviceCreateInfo::default()
        .enabled_features(&core)
        .queue_create_infos(&queues)
        .enabled_extension_names(&extensions)
        .push_next(&mut v12)
        .push_next(&mut v13);
    if optional.robust_buffers2 {
        info = info.push_next(&mut robustness2);
    }
    let mut reconvergence =
        vk::PhysicalDeviceShaderMaximalReconvergenceFeaturesKHR::default().shader_maximal_reconvergence(true);
    if optional.reconverges {
        info = info.push_next(&mut reconvergence);
    }
    let mut uniform = vk::PhysicalDeviceShaderSubgroupUniformControlFlowFeaturesKHR::default()
        .shader_subgroup_uniform_control_flow(true);
    if optional.uniform_control_flow {
        info = info.push_next(&mut uniform);
    }
    let mut executables =
        vk::PhysicalDevicePipelineExecutablePropertiesFeaturesKHR::default().pipeline_executable_info(true);
    if statistics {
        info = info.push_next(&mut executables);
    }
    // SAFETY: all features and extensions were found present (the last one comes with its extension); each struct is chained
    // once and outlives the call.
    unsafe { instance.create_device(candidate.physical, &info, None) }.map_err(vk_error("vkCreateDevice"))
}
