//! The open device.

use super::allocator::HostAllocator;
use super::arenas::Registry;
use super::audit;
use super::clock::Clock;
use super::create_device;
use super::debug::{Messages, Names};
use super::descriptors::{self, DescriptorSets};
use super::device::{self, Candidate, DeviceDescription};
use super::faults::{self, Faults};
use super::guards::Guarded;
use super::instance::Instance;
use super::limits::{Limits, LimitsOverride, SpecOverride};
use super::pipeline_cache::{PipelineCache, PipelineCacheData};
use super::profile::Log;
use super::submit::Objects;
use crate::{Error, Result};
use ash::vk;
use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::time::Duration;

/// How to open a device.
#[derive(Clone, Debug)]
pub struct ContextOptions {
    /// Index of the device or part of its name. None: the environment variable `ASHSPLAT_DEVICE`, or
    /// otherwise the best device.
    pub device: Option<String>,
    /// Turn on the Khronos validation layer with synchronization validation. It is an error if the layer is
    /// not installed. With a layer of 2023, open and close such devices only while no other thread uses
    /// another one: its table of devices has no lock.
    pub validation: bool,
    /// Panic if a recording lacks a barrier. Default: in debug builds.
    pub hazard_check: bool,
    /// Time scopes if the device can. Default: yes.
    pub timestamps: bool,
    /// Subgroup size of all kernels, if the device supports the choice. None: the device's default.
    pub subgroup_size: Option<u32>,
    /// Stricter limits than the device's, for tests.
    pub limits_override: Option<LimitsOverride>,
    /// Turn on the validation layer for `debugPrintfEXT` in shaders; [`Context::printed`] returns the output.
    /// It is an error if the layer is not installed.
    pub debug_printf: bool,
    /// Overrides of specialization constants.
    pub overrides: Vec<SpecOverride>,
    /// For tests: transfer through staging memory, as on a discrete GPU, even if device memory can be mapped.
    pub force_staging: bool,
    /// For a capture by RenderDoc: accept Vulkan 1.2. Its layer reports this version for every driver without
    /// bufferDeviceAddressCaptureReplay, for example llvmpipe, although it passes 1.3 on.
    pub capture: bool,
    /// Longest wait for a submission before it is an error. None: no limit. The driver resets a device that
    /// hangs, and reports it.
    pub timeout: Option<Duration>,
    /// Most bytes of device and staging memory, all arenas together. None: the device's memory.
    pub max_memory: Option<u64>,
    /// For tests: guard bands around every buffer that detect writes outside of it; see
    /// [`Context::breached_guards`].
    pub guard_bands: bool,
    /// For tests: Vulkan calls that fail on demand.
    pub faults: Option<Faults>,
    /// Use VK_KHR_push_descriptor if the device has it. Default: yes.
    pub push_descriptors: bool,
    /// Let kernels read buffers as texels on processors, where that is faster. The views are made while
    /// recording, so buffers and command buffers of a host cannot be adopted then. Default: yes; never on a
    /// host's device.
    pub texels: bool,
    /// Build kernels with a VkPipelineCache that is kept between runs. Default: none; on a host's device see
    /// [`ForeignDevice::pipeline_cache`](super::ForeignDevice::pipeline_cache).
    pub pipeline_cache: Option<PipelineCacheData>,
}

impl ContextOptions {
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
            limits_override: None,
            debug_printf: false,
            overrides: Vec::new(),
            force_staging: false,
            capture: false,
            timeout: None,
            max_memory: None,
            guard_bands: false,
            faults: None,
            push_descriptors: true,
            texels: true,
            pipeline_cache: None,
        }
    }
}

/// An open device with its queue. Cheap to clone; buffers, kernels and recordings keep it open.
///
/// # Examples
/// ```no_run
/// use ashsplat::vk::{Context, ContextOptions};
///
/// # fn main() -> ashsplat::Result<()> {
/// let options = ContextOptions { device: Some("llvmpipe".into()), ..ContextOptions::default() };
/// let context = Context::new(&options)?;
/// println!("{}, subgroups of {}", context.device_name(), context.limits().subgroup_size);
/// # Ok(())
/// # }
/// ```
#[derive(Clone)]
pub struct Context(pub(super) Arc<Inner>);

pub(super) struct Inner {
    pub(super) device: ash::Device,
    /// None: descriptor sets of `shared_layouts` are bound.
    pub(super) push_descriptor: Option<ash::khr::push_descriptor::Device>,
    /// Present without push descriptors.
    pub(super) shared_layouts: Option<descriptors::SharedLayouts>,
    pub(super) names: Names,
    /// None on a host's device whose host keeps the queue to itself.
    pub(super) queue: Option<Mutex<vk::Queue>>,
    pub(super) queue_family: u32,
    pub(super) physical: vk::PhysicalDevice,
    pub(super) limits: Limits,
    pub(super) memory: vk::PhysicalDeviceMemoryProperties,
    /// Whether device memory is the host's memory. Mapping is then the fastest transfer.
    pub(super) unified_memory: bool,
    pub(super) timestamp_bits: u32,
    /// Whether timestamps are currently written.
    pub(super) timestamps: AtomicBool,
    /// Reads the device's clock, if it can be compared with the host's.
    pub(super) clock: Option<Clock>,
    /// The profile that records every command, if one exists.
    pub(super) profile: Mutex<Weak<Log>>,
    /// The audit that hashes the output of every command, if one exists.
    pub(super) audit: Mutex<Weak<audit::Log>>,
    pub(super) hazard_check: bool,
    pub(super) timeout: Option<Duration>,
    pub(super) max_memory: Option<u64>,
    pub(super) guard_bands: bool,
    /// Buffers with guard bands.
    pub(super) guarded: Mutex<Vec<Guarded>>,
    /// The physical device for budget queries: VK_EXT_memory_budget.
    pub(super) budget: Option<vk::PhysicalDevice>,
    /// Whether the device is lost.
    pub(super) lost: AtomicBool,
    pub(super) description: DeviceDescription,
    pub(super) registry: Registry,
    /// SPIR-V that replaces a kernel's own.
    pub(super) replaced: Mutex<HashMap<String, Arc<Vec<u32>>>>,
    /// Idle command buffers.
    pub(super) idle_objects: Mutex<Vec<Objects>>,
    /// Idle descriptor sets, where there are no push descriptors.
    pub(super) descriptors: Mutex<Vec<DescriptorSets>>,
    /// The allocator of the buffers' memory; None: the device.
    pub(super) allocator: Option<Arc<dyn HostAllocator>>,
    /// What kernels are built with.
    pub(super) pipeline_cache: PipelineCache,
    // Destroyed after the device: keep it last.
    pub(super) owner: Owner,
}

/// Owner of the instance and the device.
pub(super) enum Owner {
    /// This context, which destroys them.
    Us(Instance),
    /// A host. They are neither destroyed nor waited for.
    Host(ash::Instance),
}

impl Owner {
    pub(super) fn instance(&self) -> &ash::Instance {
        match self {
            Self::Us(instance) => &instance.raw,
            Self::Host(instance) => instance,
        }
    }

    fn messages(&self) -> Option<&Messages> {
        match self {
            Self::Us(instance) => instance.messenger.as_ref().map(|m| &*m.messages),
            Self::Host(_) => None,
        }
    }
}

/// The parts of an open device: see [`Context::assemble`].
pub(super) struct Parts<'a> {
    pub(super) owner: Owner,
    pub(super) candidate: Candidate,
    pub(super) device: ash::Device,
    pub(super) queue: Option<vk::Queue>,
    pub(super) debug_utils: bool,
    pub(super) allocator: Option<Arc<dyn HostAllocator>>,
    /// A host's; null: none.
    pub(super) pipeline_cache: vk::PipelineCache,
    pub(super) options: &'a ContextOptions,
}

impl Context {
    /// Opens a device.
    ///
    /// # Errors
    /// [`Error::NoLoader`], [`Error::NoDevice`], [`Error::UnknownDevice`], [`Error::MissingFeature`] (also for the
    /// validation layer), [`Error::Argument`] for a subgroup size that the device does not have.
    pub fn new(options: &ContextOptions) -> Result<Self> {
        let instance = Instance::new(options.validation, options.debug_printf)?;
        let from_environment = std::env::var("ASHSPLAT_DEVICE").ok().filter(|d| !d.trim().is_empty());
        let asked = options.device.clone().or(from_environment);
        let mut candidate = device::choose(&instance.raw, asked.as_deref(), options.least_version())?;
        candidate.features.push_descriptor &= options.push_descriptors;
        let device = create_device::create_device(&instance.raw, &candidate, options.debug_printf)?;
        // SAFETY: the device was created with one queue of this family.
        let queue = unsafe { device.get_device_queue(candidate.queue_family, 0) };
        let device = match &options.faults {
            Some(faults) => faults::install(&device, Some(queue), faults),
            None => device,
        };
        let debug_utils = instance.has_debug_utils;
        let context = Self::assemble(Parts {
            owner: Owner::Us(instance),
            candidate,
            device,
            queue: Some(queue),
            debug_utils,
            allocator: None,
            pipeline_cache: vk::PipelineCache::null(),
            options,
        })?;
        context.0.names.name(queue, "ashsplat queue");
        Ok(context)
    }

    /// A context from a device that fulfils the requirements. On failure it destroys a device of its own.
    pub(super) fn assemble(parts: Parts<'_>) -> Result<Self> {
        let Parts { owner, candidate, device, queue, debug_utils, allocator, pipeline_cache, options } =
            parts;
        let instance = owner.instance();
        // SAFETY: the physical device is of this instance.
        let (memory, families) = unsafe {
            (
                instance.get_physical_device_memory_properties(candidate.physical),
                instance.get_physical_device_queue_family_properties(candidate.physical),
            )
        };
        let family = families.get(candidate.queue_family as usize).copied().unwrap_or_default();
        let push = candidate.features.push_descriptor;
        let foreign = !matches!(owner, Owner::Us(_));
        let opened = effective_limits(&candidate, options).and_then(|mut limits| {
            if foreign || !options.texels || !candidate.features.int64 {
                // Views of buffers are made while recording, and a host's buffers may lack the usage. Kernels that read
                // texels write integers of 64 bits.
                limits.max_texels = 0;
            }
            if push {
                return Ok((limits, None));
            }
            limits.max_texels = 0;
            limits.max_push_descriptors = descriptors::BUFFERS;
            Ok((limits, Some(descriptors::shared_layouts(&device)?)))
        });
        let opened = opened.and_then(|(limits, layouts)| {
            let cache = match &options.pipeline_cache {
                Some(own) if !foreign => {
                    // SAFETY: the physical device is of this instance.
                    let properties = unsafe { instance.get_physical_device_properties(candidate.physical) };
                    PipelineCache::of_data(&device, &properties, own.clone())
                }
                _ => Ok(PipelineCache::of_host(pipeline_cache)),
            };
            let cache = cache.inspect_err(|_| {
                if let Some(layouts) = &layouts {
                    descriptors::destroy_layouts(&device, layouts);
                }
            })?;
            Ok((limits, layouts, cache))
        });
        let (limits, shared_layouts, pipeline_cache) = opened.inspect_err(|_| {
            faults::remove(device.handle());
            if let Owner::Us(_) = owner {
                // SAFETY: nothing was made from it yet.
                unsafe { device.destroy_device(None) }
            }
        })?;
        Ok(Self(Arc::new(Inner {
            push_descriptor: push.then(|| ash::khr::push_descriptor::Device::new(instance, &device)),
            shared_layouts,
            clock: Clock::new(instance, &device, candidate.features.calibrated_timestamps),
            names: Names::new(instance, &device, debug_utils),
            device,
            queue: queue.map(Mutex::new),
            queue_family: candidate.queue_family,
            physical: candidate.physical,
            limits,
            memory,
            unified_memory: !options.force_staging && candidate.has_unified_memory(),
            timestamp_bits: if options.timestamps { family.timestamp_valid_bits } else { 0 },
            timestamps: AtomicBool::new(true),
            profile: Mutex::default(),
            audit: Mutex::default(),
            hazard_check: options.hazard_check,
            timeout: options.timeout,
            max_memory: options.max_memory,
            guard_bands: options.guard_bands,
            guarded: Mutex::default(),
            budget: candidate.features.memory_budget.then_some(candidate.physical),
            lost: AtomicBool::new(false),
            description: candidate.description,
            registry: Registry::default(),
            replaced: Mutex::default(),
            idle_objects: Mutex::default(),
            descriptors: Mutex::default(),
            allocator,
            pipeline_cache,
            owner,
        })))
    }

    /// The device's limits, with the changes of the options.
    pub fn limits(&self) -> &Limits {
        &self.0.limits
    }

    /// The driver's name of the device.
    pub fn device_name(&self) -> &str {
        &self.0.description.name
    }

    /// The driver's description of the device. Its limits are without the changes of the options.
    pub fn description(&self) -> &DeviceDescription {
        &self.0.description
    }

    /// All warnings and errors of the validation layers so far. Empty without [`ContextOptions::validation`].
    pub fn validation_messages(&self) -> Vec<String> {
        self.0.owner.messages().map_or_else(Vec::new, Messages::all)
    }

    /// Whether the device is lost, which makes this context unusable.
    pub fn is_lost(&self) -> bool {
        self.0.lost.load(Ordering::Relaxed)
    }

    /// Drops this handle. If it was the last holder of the device, the device is destroyed, and all messages
    /// of the validation layers are returned, including leaks.
    pub fn close(self) -> Option<Vec<String>> {
        let messages = match &self.0.owner {
            Owner::Us(instance) => instance.messenger.as_ref().map(|m| m.messages.clone()),
            Owner::Host(_) => None,
        };
        drop(Arc::into_inner(self.0)?);
        Some(messages.map_or_else(Vec::new, |messages| messages.all()))
    }

    /// What shaders printed since the last call. Empty without [`ContextOptions::debug_printf`].
    pub fn printed(&self) -> Vec<String> {
        self.0.owner.messages().map_or_else(Vec::new, Messages::take_printed)
    }
}

impl Inner {
    /// Locks the queue for this thread.
    pub(super) fn lock_queue(&self) -> Result<MutexGuard<'_, vk::Queue>> {
        let Some(queue) = &self.queue else {
            let problem = "the host keeps its queue: only recording into its command buffers is possible";
            return Err(Error::argument("queue", problem));
        };
        Ok(queue.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

impl Drop for Inner {
    fn drop(&mut self) {
        let idle = std::mem::take(&mut *self.idle_objects.lock().unwrap_or_else(PoisonError::into_inner));
        faults::remove(self.device.handle());
        let mut sets = std::mem::take(&mut *self.descriptors.lock().unwrap_or_else(PoisonError::into_inner));
        let ours = matches!(self.owner, Owner::Us(_));
        // SAFETY: nothing refers to the device any more: all that does holds this struct, and every submission of ours
        // was waited for. The wait is for own devices that were lost; a host's device is the host's to wait for.
        unsafe {
            if ours {
                let _ = self.device.device_wait_idle();
            }
            idle.iter().for_each(|objects| objects.destroy(self));
            sets.iter_mut().for_each(|sets| sets.destroy(self));
            if let Some(layouts) = &self.shared_layouts {
                descriptors::destroy_layouts(&self.device, layouts);
            }
            self.pipeline_cache.close(&self.device);
            if ours {
                self.device.destroy_device(None);
            }
        }
    }
}

fn effective_limits(candidate: &Candidate, options: &ContextOptions) -> Result<Limits> {
    let device = &candidate.description;
    let Some(limits) = device.limits.clone() else {
        return Err(Error::MissingFeature { device: device.name.clone(), feature: "Vulkan 1.3".into() });
    };
    let mut limits = limits.lowered(&options.limits_override.unwrap_or_default());
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
        limits.subgroup_size = size;
    }
    Ok(limits)
}
