//! The device that everything runs on.

use super::audit;
use super::clock::Clock;
use super::debug::Names;
use super::device::{self, Candidate, DeviceDescription};
use super::faults::{self, Faults};
use super::guards::Guarded;
use super::instance::Instance;
use super::limits::{Limits, LimitsOverride, SpecOverride};
use super::memory::Registry;
use super::profile::Log;
use super::submit::Slot;
use super::vk_error;
use crate::{Error, Result};
use ash::vk;
use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError, Weak};
use std::time::Duration;

/// How to open a device.
#[derive(Clone, Debug)]
pub struct ContextOptions {
    /// Index of the device or part of its name. None: what the environment variable `ASHSPLAT_DEVICE` says, else the
    /// best there is.
    pub device: Option<String>,
    /// Turn on the Khronos validation layer with synchronization validation; an error where it is not installed.
    pub validation: bool,
    /// Panic where a recording lacks a barrier. Default: in debug builds.
    pub hazard_check: bool,
    /// Time scopes, where the device can. Default: yes.
    pub timestamps: bool,
    /// Subgroup size to pin kernels to, where the device lets choose. None: the device's own.
    pub subgroup_size: Option<u32>,
    /// Stricter limits than the device's, for tests.
    pub limits_override: Option<LimitsOverride>,
    /// Turn on the validation layer for `debugPrintfEXT` in shaders; what they print is in
    /// [`Context::printed`]. An error where the layer is not installed.
    pub debug_printf: bool,
    /// Other values for specialization constants.
    pub overrides: Vec<SpecOverride>,
    /// For tests: transfer through staging memory, as on a discrete GPU, also where device memory could be mapped.
    pub force_staging: bool,
    /// For a capture by RenderDoc: accept the version 1.2 that its layer reports of every driver without
    /// bufferDeviceAddressCaptureReplay, llvmpipe among them, although it passes 1.3 on.
    pub capture: bool,
    /// How long to wait for a submission before it is an error. None: until it is over, however long that takes; a
    /// device that hangs is reset and reported by its driver.
    pub timeout: Option<Duration>,
    /// Most bytes of device and staging memory to allocate, all arenas together. None: what the device has.
    pub max_memory: Option<u64>,
    /// For tests: bands around every buffer that show what was written outside of it; see
    /// [`Context::breached_guards`].
    pub guard_bands: bool,
    /// For tests: Vulkan calls that fail on demand.
    pub faults: Option<Faults>,
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
        }
    }
}

/// An open device with its queue. Cheap to clone; buffers, kernels and recordings keep it open.
#[derive(Clone)]
pub struct Context(pub(super) Arc<Inner>);

pub(super) struct Inner {
    pub(super) device: ash::Device,
    pub(super) push_descriptor: ash::khr::push_descriptor::Device,
    pub(super) names: Names,
    pub(super) queue: Mutex<vk::Queue>,
    pub(super) queue_family: u32,
    pub(super) limits: Limits,
    pub(super) memory: vk::PhysicalDeviceMemoryProperties,
    /// Whether device memory is the host's memory, so that mapping it is the fastest way in and out.
    pub(super) unified_memory: bool,
    pub(super) timestamp_bits: u32,
    /// Whether timestamps are written at the moment.
    pub(super) timestamps: AtomicBool,
    /// Reads the device's clock, where it can be compared with the host's.
    pub(super) clock: Option<Clock>,
    /// Who records every command, if anybody does.
    pub(super) profile: Mutex<Weak<Log>>,
    /// Who hashes what every command writes, if anybody does.
    pub(super) audit: Mutex<Weak<audit::Log>>,
    pub(super) hazard_check: bool,
    pub(super) timeout: Option<Duration>,
    pub(super) max_memory: Option<u64>,
    pub(super) guard_bands: bool,
    /// Buffers that have bands around them.
    pub(super) guarded: Mutex<Vec<Guarded>>,
    /// Where the driver can be asked how much memory it would give: VK_EXT_memory_budget.
    pub(super) budget: Option<vk::PhysicalDevice>,
    /// Whether the driver has given the device up.
    pub(super) lost: AtomicBool,
    pub(super) description: DeviceDescription,
    pub(super) registry: Registry,
    /// SPIR-V in place of a kernel's own.
    pub(super) replaced: Mutex<HashMap<String, Arc<Vec<u32>>>>,
    /// Idle command buffers.
    pub(super) slots: Mutex<Vec<Slot>>,
    // Destroyed after the device: keep it last.
    pub(super) instance: Instance,
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
        let candidate = device::choose(&instance, asked.as_deref(), options.least_version())?;
        let limits = effective_limits(&candidate, options)?;
        // SAFETY: the physical device is of this instance.
        let (memory, families) = unsafe {
            (
                instance.raw.get_physical_device_memory_properties(candidate.physical),
                instance.raw.get_physical_device_queue_family_properties(candidate.physical),
            )
        };
        let family = families.get(candidate.queue_family as usize).copied().unwrap_or_default();
        let device = create_device(&instance, &candidate, options.debug_printf)?;
        // SAFETY: the device was created with one queue of this family.
        let queue = unsafe { device.get_device_queue(candidate.queue_family, 0) };
        let device = match &options.faults {
            Some(faults) => faults::install(&device, queue, faults),
            None => device,
        };
        let clock = Clock::new(&instance, &device, candidate.features.calibrated_timestamps);
        let names = Names::new(&instance.raw, &device, instance.has_debug_utils);
        names.name(queue, "ashsplat queue");
        Ok(Self(Arc::new(Inner {
            push_descriptor: ash::khr::push_descriptor::Device::new(&instance.raw, &device),
            device,
            names,
            queue: Mutex::new(queue),
            queue_family: candidate.queue_family,
            limits,
            memory,
            unified_memory: !options.force_staging
                && matches!(
                    candidate.device_type,
                    vk::PhysicalDeviceType::CPU | vk::PhysicalDeviceType::INTEGRATED_GPU
                ),
            timestamp_bits: if options.timestamps { family.timestamp_valid_bits } else { 0 },
            timestamps: AtomicBool::new(true),
            clock,
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
            slots: Mutex::default(),
            instance,
        })))
    }

    /// The device's limits, with the options' changes.
    pub fn limits(&self) -> &Limits {
        &self.0.limits
    }

    /// The device's name, as the driver gives it.
    pub fn device_name(&self) -> &str {
        &self.0.description.name
    }

    /// What the driver says of the device; its limits are those without the options' changes.
    pub fn description(&self) -> &DeviceDescription {
        &self.0.description
    }

    /// All warnings and errors of the validation layers so far. Empty without [`ContextOptions::validation`].
    pub fn validation_messages(&self) -> Vec<String> {
        self.0.instance.messenger.as_ref().map_or_else(Vec::new, |m| m.messages.all())
    }

    /// Whether the driver has given the device up: then nothing of this context works any more.
    pub fn is_lost(&self) -> bool {
        self.0.lost.load(Ordering::Relaxed)
    }

    /// Gives up this handle. Where it was the last holder of the device, the device is destroyed; the answer is
    /// everything that the validation layers have said until then, with what has leaked.
    pub fn close(self) -> Option<Vec<String>> {
        let messages = self.0.instance.messenger.as_ref().map(|m| m.messages.clone());
        drop(Arc::into_inner(self.0)?);
        Some(messages.map_or_else(Vec::new, |messages| messages.all()))
    }

    /// What shaders printed since the last call. Empty without [`ContextOptions::debug_printf`].
    pub fn printed(&self) -> Vec<String> {
        self.0.instance.messenger.as_ref().map_or_else(Vec::new, |m| m.messages.take_printed())
    }
}

impl Drop for Inner {
    fn drop(&mut self) {
        let slots = std::mem::take(&mut *self.slots.lock().unwrap_or_else(PoisonError::into_inner));
        let queue = *self.queue.get_mut().unwrap_or_else(PoisonError::into_inner);
        faults::remove(self.device.handle(), queue);
        // SAFETY: nothing refers to the device any more: all that does holds this struct. The wait is for devices
        // that were lost.
        unsafe {
            let _ = self.device.device_wait_idle();
            slots.iter().for_each(|slot| slot.destroy(self));
            self.device.destroy_device(None);
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

fn create_device(instance: &Instance, candidate: &Candidate, printf: bool) -> Result<ash::Device> {
    let optional = &candidate.features;
    let mut v12 = vk::PhysicalDeviceVulkan12Features::default()
        .scalar_block_layout(true)
        .host_query_reset(true)
        .shader_int8(optional.int8)
        .storage_buffer8_bit_access(optional.storage8)
        .uniform_and_storage_buffer8_bit_access(optional.uniform_storage8)
        .vulkan_memory_model(optional.memory_model)
        .vulkan_memory_model_device_scope(optional.memory_model_device_scope);
    let mut v13 = vk::PhysicalDeviceVulkan13Features::default()
        .synchronization2(true)
        .maintenance4(true)
        .subgroup_size_control(true)
        .compute_full_subgroups(true);
    let mut extensions = vec![ash::khr::push_descriptor::NAME.as_ptr()];
    if optional.portability_subset {
        extensions.push(c"VK_KHR_portability_subset".as_ptr());
    }
    if optional.memory_budget {
        extensions.push(ash::ext::memory_budget::NAME.as_ptr());
    }
    extensions.extend(optional.calibrated_timestamps.map(|kind| kind.extension().as_ptr()));
    let priorities = [1.0];
    let queues = [vk::DeviceQueueCreateInfo::default()
        .queue_family_index(candidate.queue_family)
        .queue_priorities(&priorities)];
    // Without them the layer refuses to print.
    let printing = printf && optional.graphics_stores;
    let core = vk::PhysicalDeviceFeatures::default()
        .fragment_stores_and_atomics(printing)
        .vertex_pipeline_stores_and_atomics(printing);
    let info = vk::DeviceCreateInfo::default()
        .enabled_features(&core)
        .queue_create_infos(&queues)
        .enabled_extension_names(&extensions)
        .push_next(&mut v12)
        .push_next(&mut v13);
    // SAFETY: all features and extensions were found present; each struct is chained once and outlives the call.
    unsafe { instance.raw.create_device(candidate.physical, &info, None) }.map_err(vk_error("vkCreateDevice"))
}
