//! Opens a device: the options, and the context of our own device or of a host's.

use super::allocate::UNBOUNDED;
use super::allocator::HostAllocator;
use super::arenas::Registry;
use super::binding_numbers::BUFFERS;
use super::built::BuiltPipelines;
use super::clock::Clock;
use super::context::Context;
use super::debug::Names;
use super::debug::vk_error;
use super::device::{self, Candidate};
use super::executables::{CompileOnly, Executables};
#[cfg(feature = "testing")]
use super::faults::Faults;
use super::instance::Instance;
use super::limits::{Limits, SpecOverride};
#[cfg(feature = "testing")]
use super::limits_override::LimitsOverride;
use super::memory_types::Place;
use super::open_device::{CopyQueue, Device, Owner, QueueLock};
use super::pipeline_cache::{PipelineCache, PipelineCacheStore};
use super::raw_device::RawDevice;
use super::requirements::{Features, Requirements};
use super::spirv::{Reconvergence, SubgroupRules};
use super::{compile_only, descriptors};
use crate::tuning::{Backend, Tuning};
use crate::{Error, Result};
use ash::vk;
use std::ffi::CStr;
use std::sync::atomic::{AtomicBool, AtomicU64};
use std::sync::{Arc, Mutex};
use std::time::Duration;

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
    /// [`Tuning::lanes`](crate::tuning::Tuning::lanes) and [`Tuning::heavy_lanes`](crate::tuning::Tuning::heavy_lanes), or
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
        let named = std::env::var_os("ASHSPLAT_BACKEND").filter(|name| !name.is_empty());
        let named = named.map(|name| {
            name.to_string_lossy().parse().map_err(|e: String| Error::argument("ASHSPLAT_BACKEND", e))
        });
        self.backend.map(Ok).or(named).transpose()
    }

    fn least_version(&self) -> u32 {
        if self.capture { vk::API_VERSION_1_2 } else { vk::API_VERSION_1_3 }
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

/// Parts of an open device: see [`Context::assemble`].
pub(super) struct Parts<'a> {
    // Field order matters: the device is dropped before its instance.
    pub(super) device: RawDevice,
    pub(super) owner: Owner,
    pub(super) candidate: Candidate,
    /// From [`effective_limits`].
    pub(super) limits: Limits,
    pub(super) queue: Option<vk::Queue>,
    pub(super) queue_lock: Option<Arc<dyn QueueLock>>,
    pub(super) debug_utils: bool,
    pub(super) allocator: Option<Arc<dyn HostAllocator>>,
    /// A host's cache; null: none.
    pub(super) pipeline_cache: vk::PipelineCache,
    pub(super) options: &'a ContextOptions,
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
        let asked = options.device.clone().or(from_environment);
        let mut candidate = device::choose(&instance.raw, asked.as_deref(), options.least_version())?;
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
            candidate.features.calibrated_timestamps = None;
            limits.heap_bytes = compile_only::memory_properties().memory_heaps[0].size;
        }
        let wishes = Wishes {
            printf: options.debug_printf,
            executables: options.compile_only.is_some(),
            extensions: &options.device_extensions,
        };
        let raw = create_device(&instance.raw, &candidate, &wishes)?;
        let device = RawDevice::ours(match options.compile_only {
            // SAFETY: the device is of this instance.
            Some(_) => unsafe { compile_only::table(&instance.raw, &raw) },
            None => raw,
        });
        // SAFETY: the device was created with one queue of this family.
        let queue = unsafe { device.get_device_queue(candidate.queue_family, 0) };
        let debug_utils = instance.has_debug_utils && options.compile_only.is_none();
        let context = Self::assemble(Parts {
            owner: Owner::Us(instance),
            candidate,
            limits,
            device,
            queue: Some(queue),
            queue_lock: None,
            debug_utils,
            allocator: None,
            pipeline_cache: vk::PipelineCache::null(),
            options,
        })?;
        context.device.names.name(queue, "ashsplat queue");
        Ok(context)
    }

    /// Assembles a context from a device that fulfils the requirements. On failure it destroys a device of our own.
    pub(super) fn assemble(parts: Parts<'_>) -> Result<Self> {
        let Parts {
            owner,
            candidate,
            mut limits,
            device,
            queue,
            queue_lock,
            debug_utils,
            allocator,
            pipeline_cache,
            options,
        } = parts;
        let instance = owner.instance();
        // SAFETY: the physical device is of this instance.
        let (mut memory, families, properties) = unsafe {
            (
                instance.get_physical_device_memory_properties(candidate.physical),
                instance.get_physical_device_queue_family_properties(candidate.physical),
                instance.get_physical_device_properties(candidate.physical),
            )
        };
        let family = families.get(candidate.queue_family as usize).copied().unwrap_or_default();
        let push = candidate.features.push_descriptor;
        let foreign = !matches!(owner, Owner::Us(_));
        if foreign || !push || !options.texels || !candidate.features.int64 {
            // Buffer views are made while recording, and a host's buffers may lack the usage. Kernels that read texels
            // write 64-bit integers.
            limits.max_texels = 0;
        }
        limits.broadcasts = limits.tuning.broadcasts && candidate.features.dynamic_broadcasts;
        if !push {
            limits.max_push_descriptors = BUFFERS;
        }
        let runs = options.compile_only.is_none();
        if !runs {
            memory = compile_only::memory_properties();
        }
        let place = match candidate.has_unified_memory() || !runs {
            true => Place::Unified,
            false if foreign || !options.direct_writes => Place::Card,
            false => Place::of_card(&memory),
        };
        #[cfg(feature = "testing")]
        let place = if options.force_staging { Place::Card } else { place };
        // From here on, dropping `open` destroys everything created so far.
        let mut open = Device {
            push_descriptor: push.then(|| match runs {
                true => ash::khr::push_descriptor::Device::new(instance, &device),
                false => compile_only::push_descriptor(&device),
            }),
            executables: options.compile_only.map(|asked| Executables::new(instance, &device, asked)),
            shared_layouts: None,
            clock: Clock::new(instance, &device, candidate.features.calibrated_timestamps),
            names: Names::new(instance, &device, debug_utils),
            device,
            queue: queue.map(Mutex::new),
            queue_lock,
            queue_family: candidate.queue_family,
            copying: None,
            physical: candidate.physical,
            subgroup_rules: SubgroupRules {
                fixed_size: !limits.subgroup_size_selectable,
                reconvergence: Reconvergence::of(&candidate.features),
                broadcasts: candidate.features.dynamic_broadcasts,
            },
            limits,
            memory,
            place,
            #[cfg(feature = "testing")]
            force_uncached: options.force_uncached,
            timestamp_bits: if options.timestamps && runs { family.timestamp_valid_bits } else { 0 },
            timestamps: AtomicBool::new(true),
            hazard_check: options.hazard_check,
            timeout: options.timeout,
            max_memory: AtomicU64::new(options.max_memory.unwrap_or(UNBOUNDED)),
            offload: AtomicU64::new(options.offload.unwrap_or(0)),
            #[cfg(feature = "testing")]
            guard_bands: options.guard_bands,
            budget: candidate.features.memory_budget.then_some(candidate.physical),
            lost: AtomicBool::new(false),
            description: candidate.description,
            registry: Registry::default(),
            replaced: Mutex::default(),
            built: BuiltPipelines::default(),
            subgroups_are_sound: AtomicBool::new(false),
            allocator,
            pipeline_cache: PipelineCache::of_host(pipeline_cache),
            owner,
        };
        #[cfg(feature = "testing")]
        open.device.faults.clone_from(&options.faults);
        if let (Some(family), false) = (candidate.copying_family, foreign) {
            open.copying = Some(CopyQueue::new(&open.device, family)?);
        }
        if !push {
            descriptors::add_shared_layouts(&mut open)?;
        }
        if let (Some(store), false) = (&options.pipeline_cache, foreign || !runs) {
            open.pipeline_cache = PipelineCache::of_store(&open.device, &properties, store.clone())?;
        }
        Ok(Self::on(Arc::new(open)))
    }
}

/// Returns the device's limits, as changed by the options.
pub(super) fn effective_limits(candidate: &Candidate, options: &ContextOptions) -> Result<Limits> {
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
            let range = if limits.subgroup_size_selectable {
                format!("'{}' has powers of two from {min} to {max}", device.name)
            } else {
                format!("'{}' has only {}", device.name, limits.subgroup_size)
            };
            return Err(Error::argument(format!("subgroup size {size}"), range));
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

// Creates a device of our own.

/// Optional requests beyond the required features.
pub(super) struct Wishes<'a> {
    /// Shaders may print.
    pub printf: bool,
    /// Pipelines report compiler statistics.
    pub executables: bool,
    pub extensions: &'a [&'a CStr],
}

/// Creates a device with the required features, its optional features and the wishes. It has a main queue, and a copy queue
/// if there is a family for copies.
pub(super) fn create_device(
    instance: &ash::Instance,
    candidate: &Candidate,
    wishes: &Wishes<'_>,
) -> Result<ash::Device> {
    let optional = &candidate.features;
    let statistics = wishes.executables.then_some(ash::khr::pipeline_executable_properties::NAME);
    let further: Vec<&CStr> = wishes.extensions.iter().copied().chain(statistics).collect();
    let mut v12 = vk::PhysicalDeviceVulkan12Features::default()
        .shader_int8(optional.int8)
        .storage_buffer8_bit_access(optional.storage8)
        .uniform_and_storage_buffer8_bit_access(optional.uniform_storage8)
        .vulkan_memory_model(optional.memory_model)
        .vulkan_memory_model_device_scope(optional.memory_model_device_scope)
        .subgroup_broadcast_dynamic_id(optional.dynamic_broadcasts)
        // Every device of Vulkan 1.2 has it.
        .timeline_semaphore(candidate.copying_family.is_some());
    let mut v13 = vk::PhysicalDeviceVulkan13Features::default();
    Features::REQUIRED.merge_into(&mut v12, &mut v13);
    // SAFETY: a plain query.
    let present = unsafe { instance.enumerate_device_extension_properties(candidate.physical) };
    let present = present.map_err(vk_error("vkEnumerateDeviceExtensionProperties"))?;
    let has = |name: &CStr| present.iter().any(|e| e.extension_name_as_c_str() == Ok(name));
    if let Some(lacking) = further.iter().find(|name| !has(name)) {
        let feature = lacking.to_string_lossy().into_owned();
        return Err(Error::MissingFeature { device: candidate.description.name.clone(), feature });
    }
    let mut extensions: Vec<_> = further.iter().map(|name| name.as_ptr()).collect();
    if optional.push_descriptor {
        extensions.push(ash::khr::push_descriptor::NAME.as_ptr());
    }
    if optional.portability_subset {
        extensions.push(c"VK_KHR_portability_subset".as_ptr());
    }
    if optional.memory_budget {
        extensions.push(ash::ext::memory_budget::NAME.as_ptr());
    }
    if optional.robust_buffers2 {
        extensions.push(ash::ext::robustness2::NAME.as_ptr());
    }
    if optional.reconverges {
        extensions.push(ash::khr::shader_maximal_reconvergence::NAME.as_ptr());
    }
    if optional.uniform_control_flow {
        extensions.push(ash::khr::shader_subgroup_uniform_control_flow::NAME.as_ptr());
    }
    extensions.extend(optional.calibrated_timestamps.map(|kind| kind.extension().as_ptr()));
    let priorities = [1.0];
    let families = std::iter::once(candidate.queue_family).chain(candidate.copying_family);
    let queue = |family| {
        vk::DeviceQueueCreateInfo::default().queue_family_index(family).queue_priorities(&priorities)
    };
    let queues: Vec<_> = families.map(queue).collect();
    // Without these features the layer refuses to print.
    let printing = wishes.printf && optional.graphics_stores;
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
    if wishes.executables {
        info = info.push_next(&mut executables);
    }
    // SAFETY: all features and extensions were found present (the last one comes with its extension); each struct is chained
    // once and outlives the call.
    unsafe { instance.create_device(candidate.physical, &info, None) }.map_err(vk_error("vkCreateDevice"))
}
