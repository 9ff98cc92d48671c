//! The open device: its functions, properties and settings, and state shared by everything made from it. It knows nothing
//! of buffers, kernels or recordings, which depend on it.

use super::allocator::HostAllocator;
use super::arenas::Registry;
use super::built::BuiltPipelines;
use super::clock::Clock;
use super::copy_queue::CopyQueue;
use super::debug::{Messages, Names};
use super::device::DeviceDescription;
use super::error::vk_error;
use super::executables::Executables;
use super::instance::Instance;
use super::limits::Limits;
use super::memory_types::Place;
use super::pipeline_cache::PipelineCache;
use super::queue_lock::QueueLock;
use super::raw_device::RawDevice;
use super::spirv::SubgroupRules;
use crate::{Error, Result};
use ash::vk;
use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// An open device. Everything made from it keeps it open.
pub(super) struct Device {
    /// Its functions.
    pub(super) device: RawDevice,
    /// None: sets of `shared_layouts` are bound instead.
    pub(super) push_descriptor: Option<ash::khr::push_descriptor::Device>,
    /// Present with [`super::ContextOptions::compile_only`].
    pub(super) executables: Option<Executables>,
    /// Present without push descriptors: the layouts of the module `descriptors`.
    pub(super) shared_layouts: Option<Vec<vk::DescriptorSetLayout>>,
    pub(super) names: Names,
    /// None if a host keeps its queue to itself.
    pub(super) queue: Option<Mutex<vk::Queue>>,
    /// A host's lock of the queue.
    pub(super) queue_lock: Option<Arc<dyn QueueLock>>,
    pub(super) queue_family: u32,
    /// Runs uploads if device memory is not mapped. None on a host's device, or without such a queue family.
    pub(super) copying: Option<CopyQueue>,
    pub(super) physical: vk::PhysicalDevice,
    pub(super) limits: Limits,
    /// Rules for kernels that use subgroups.
    pub(super) subgroup_rules: SubgroupRules,
    pub(super) memory: vk::PhysicalDeviceMemoryProperties,
    /// Location of device memory, which decides between mapping and staging.
    pub(super) place: Place,
    #[cfg(feature = "testing")]
    pub(super) force_uncached: bool,
    pub(super) timestamp_bits: u32,
    /// True while timestamps are written.
    pub(super) timestamps: AtomicBool,
    /// Reads the device's clock, if it can be compared with the host's.
    pub(super) clock: Option<Clock>,
    pub(super) hazard_check: bool,
    pub(super) timeout: Option<Duration>,
    /// Most bytes of all arenas together; [`UNBOUNDED`] for no bound.
    pub(super) max_memory: AtomicU64,
    /// Most bytes that may be offloaded; 0 for no offloading.
    pub(super) offload: AtomicU64,
    #[cfg(feature = "testing")]
    pub(super) guard_bands: bool,
    /// Physical device for budget queries (VK_EXT_memory_budget).
    pub(super) budget: Option<vk::PhysicalDevice>,
    /// True if the device is lost.
    pub(super) lost: AtomicBool,
    pub(super) description: DeviceDescription,
    pub(super) registry: Registry,
    /// SPIR-V that replaces a kernel's own.
    pub(super) replaced: Mutex<HashMap<String, Arc<Vec<u32>>>>,
    /// Allocator of the buffers' memory; None: the device.
    pub(super) allocator: Option<Arc<dyn HostAllocator>>,
    /// Kernels that have been built.
    pub(super) built: BuiltPipelines,
    /// True after the check of [`crate::subgroups`] has passed.
    pub(super) subgroups_are_sound: AtomicBool,
    /// Cache with which kernels are built.
    pub(super) pipeline_cache: PipelineCache,
    // Destroyed after the device, so it must be the last field.
    pub(super) owner: Owner,
}

/// Owner of the instance and the device.
pub(super) enum Owner {
    /// Ours; they are destroyed with this value.
    Us(Instance),
    /// A host's; they are neither destroyed nor waited for.
    Host(ash::Instance),
}

impl Owner {
    pub(super) fn instance(&self) -> &ash::Instance {
        match self {
            Self::Us(instance) => &instance.raw,
            Self::Host(instance) => instance,
        }
    }

    pub(super) fn messages(&self) -> Option<&Arc<Messages>> {
        match self {
            Self::Us(instance) => instance.messenger.as_ref().map(|m| &m.messages),
            Self::Host(_) => None,
        }
    }
}

impl Device {
    /// True if the instance and the device are a host's.
    pub(super) fn is_foreign(&self) -> bool {
        matches!(self.owner, Owner::Host(_))
    }

    /// Returns the error of a failed call. Remembers a lost device.
    pub(super) fn failed(&self, call: &'static str, result: vk::Result) -> Error {
        self.lost.fetch_or(result == vk::Result::ERROR_DEVICE_LOST, Ordering::Relaxed);
        vk_error(call)(result)
    }

    /// Fails if kernels read texels: the views are made while recording, and a host's buffers may lack the usage.
    pub(super) fn check_adoption(&self) -> Result<()> {
        if !self.limits.prefers_texels() {
            return Ok(());
        }
        let problem = "its kernels read texels, which a host's buffers and command buffers are not fit for: open it with \
                       ContextOptions::texels off, or make one of its handles by Context::from_foreign";
        Err(Error::argument("context", problem))
    }
}

impl Drop for Device {
    fn drop(&mut self) {
        // SAFETY: nothing refers to the device any more: all that does holds this struct, and every submission of ours
        // was waited for. The wait is for own devices that were lost; a host's device is the host's to wait for.
        unsafe {
            if !self.is_foreign() {
                let _ = self.device.device_wait_idle();
            }
            self.built.close(&self.device);
            if let Some(queue) = &self.copying {
                queue.close(&self.device);
            }
            for layout in self.shared_layouts.iter().flatten() {
                self.device.destroy_descriptor_set_layout(*layout, None);
            }
        }
        self.pipeline_cache.close(&self.device);
    }
}
