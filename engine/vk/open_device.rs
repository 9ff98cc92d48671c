//! The open device: its functions, properties and settings, and what is kept for all that is made from it. It knows
//! nothing of buffers, kernels or recordings: they stand on it.

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

/// An open device, which everything made from it keeps open.
pub(super) struct Device {
    /// Its functions.
    pub(super) device: RawDevice,
    /// None: descriptor sets of `shared_layouts` are bound.
    pub(super) push_descriptor: Option<ash::khr::push_descriptor::Device>,
    /// With [`super::ContextOptions::compile_only`].
    pub(super) executables: Option<Executables>,
    /// Present without push descriptors: the layouts of the module `descriptors`.
    pub(super) shared_layouts: Option<Vec<vk::DescriptorSetLayout>>,
    pub(super) names: Names,
    /// None on a host's device whose host keeps the queue to itself.
    pub(super) queue: Option<Mutex<vk::Queue>>,
    /// A host's lock around it.
    pub(super) queue_lock: Option<Arc<dyn QueueLock>>,
    pub(super) queue_family: u32,
    /// Uploads run there where device memory is not mapped. None on a host's device, and without such a family.
    pub(super) copying: Option<CopyQueue>,
    pub(super) physical: vk::PhysicalDevice,
    pub(super) limits: Limits,
    /// Of kernels that use subgroups.
    pub(super) subgroup_rules: SubgroupRules,
    pub(super) memory: vk::PhysicalDeviceMemoryProperties,
    /// Where device memory lies: whether mapping is the fastest way in.
    pub(super) place: Place,
    #[cfg(feature = "testing")]
    pub(super) force_uncached: bool,
    pub(super) timestamp_bits: u32,
    /// Whether timestamps are currently written.
    pub(super) timestamps: AtomicBool,
    /// Reads the device's clock, if it can be compared with the host's.
    pub(super) clock: Option<Clock>,
    pub(super) hazard_check: bool,
    pub(super) timeout: Option<Duration>,
    /// Of all arenas together, bytes; [`UNBOUNDED`] for none.
    pub(super) max_memory: AtomicU64,
    /// Most bytes that are offloaded; 0 if nothing is.
    pub(super) offload: AtomicU64,
    #[cfg(feature = "testing")]
    pub(super) guard_bands: bool,
    /// The physical device for budget queries: VK_EXT_memory_budget.
    pub(super) budget: Option<vk::PhysicalDevice>,
    /// Whether the device is lost.
    pub(super) lost: AtomicBool,
    pub(super) description: DeviceDescription,
    pub(super) registry: Registry,
    /// SPIR-V that replaces a kernel's own.
    pub(super) replaced: Mutex<HashMap<String, Arc<Vec<u32>>>>,
    /// The allocator of the buffers' memory; None: the device.
    pub(super) allocator: Option<Arc<dyn HostAllocator>>,
    /// The kernels that have been built.
    pub(super) built: BuiltPipelines,
    /// Whether subgroups were found to be what the device reports.
    pub(super) subgroups_are_sound: AtomicBool,
    /// What kernels are built with.
    pub(super) pipeline_cache: PipelineCache,
    // Destroyed after the device: keep it last.
    pub(super) owner: Owner,
}

/// Owner of the instance and the device.
pub(super) enum Owner {
    /// We, who destroy them.
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

    pub(super) fn messages(&self) -> Option<&Arc<Messages>> {
        match self {
            Self::Us(instance) => instance.messenger.as_ref().map(|m| &m.messages),
            Self::Host(_) => None,
        }
    }
}

impl Device {
    /// Whether the instance and the device are a host's.
    pub(super) fn is_foreign(&self) -> bool {
        matches!(self.owner, Owner::Host(_))
    }

    /// The error of a failed call. Remembers a lost device.
    pub(super) fn failed(&self, call: &'static str, result: vk::Result) -> Error {
        self.lost.fetch_or(result == vk::Result::ERROR_DEVICE_LOST, Ordering::Relaxed);
        vk_error(call)(result)
    }

    /// Fails if kernels read texels: the views are made while recording, and a host's buffers may lack the
    /// usage.
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
