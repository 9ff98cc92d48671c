//! The open device: its functions, properties and settings, and state shared by everything made from it. It knows nothing
//! of buffers, kernels or recordings, which depend on it.

use super::compile_only::Executables;
use super::debug::{Messages, Names, vk_error};
use super::device::{DeviceDescription, Instance, queue_families};
#[cfg(feature = "testing")]
use super::faults::Faults;
use super::limits::Limits;
use super::lock::lock;
use super::memory_types::{HostAllocator, Location, Registry};
use super::pipeline_cache::{BuiltPipelines, PipelineCache};
use super::spirv::SubgroupRules;
use crate::error::{Error, Result};
use ash::vk;
use std::collections::HashMap;
use std::ops::Deref;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;

/// A device's functions. Destroys the device when dropped, if it is ours.
pub(super) struct RawDevice {
    pub(super) raw: ash::Device,
    owned: bool,
    /// For tests: calls that fail on demand.
    #[cfg(feature = "testing")]
    pub(super) faults: Option<Faults>,
}

impl RawDevice {
    /// Wraps a device that we created and nothing else destroys (`owned`), or a host's.
    pub(super) fn new(raw: ash::Device, owned: bool) -> Self {
        Self {
            raw,
            owned,
            #[cfg(feature = "testing")]
            faults: None,
        }
    }
}

impl Deref for RawDevice {
    type Target = ash::Device;

    fn deref(&self) -> &ash::Device {
        &self.raw
    }
}

impl Drop for RawDevice {
    fn drop(&mut self) {
        if self.owned {
            // SAFETY: the owner of this value has destroyed all that was made from the device, which is idle.
            unsafe { self.raw.destroy_device(None) }
        }
    }
}

/// An open device. Everything made from it keeps it open.
pub(super) struct Device {
    pub(super) device: RawDevice,
    /// None: sets of `shared_layouts` are bound instead.
    pub(super) push_descriptor: Option<ash::khr::push_descriptor::Device>,
    /// Present with [`super::ContextOptions::compile_only`].
    pub(super) executables: Option<Executables>,
    /// Present without push descriptors: the layouts of the module `pipeline`.
    pub(super) shared_layouts: Option<Vec<vk::DescriptorSetLayout>>,
    pub(super) names: Names,
    /// None if a host keeps its queue to itself.
    pub(super) queue: Option<Mutex<vk::Queue>>,
    pub(super) queue_lock: Option<Arc<dyn QueueLock>>,
    pub(super) queue_family: u32,
    /// Runs uploads if device memory is not mapped. None on a host's device, or without such a queue family.
    pub(super) copying: Option<CopyQueue>,
    pub(super) physical: vk::PhysicalDevice,
    pub(super) limits: Limits,
    pub(super) subgroup_rules: SubgroupRules,
    pub(super) memory: vk::PhysicalDeviceMemoryProperties,
    /// Location of device memory, which decides between mapping and staging.
    pub(super) location: Location,
    /// For tests: device memory counts as not cached by the host.
    pub(super) force_uncached: bool,
    pub(super) timestamp_bits: u32,
    /// True while timestamps are written.
    pub(super) timestamps: AtomicBool,
    pub(super) hazard_check: bool,
    pub(super) timeout: Option<Duration>,
    /// Most bytes of all arenas together; [`super::memory::UNBOUNDED`] for no bound.
    pub(super) max_memory: AtomicU64,
    /// Most bytes that may be offloaded; 0 for no offloading.
    pub(super) offload: AtomicU64,
    /// For tests: buffers have guard bands.
    pub(super) guard_bands: bool,
    /// Physical device for budget queries (VK_EXT_memory_budget).
    pub(super) budget: Option<vk::PhysicalDevice>,
    pub(super) lost: AtomicBool,
    pub(super) description: DeviceDescription,
    pub(super) registry: Registry,
    /// SPIR-V that replaces a kernel's own.
    pub(super) replaced: Mutex<HashMap<String, Arc<Vec<u32>>>>,
    /// Allocator of the buffers' memory; None: the device.
    pub(super) allocator: Option<Arc<dyn HostAllocator>>,
    pub(super) built: BuiltPipelines,
    /// True after the check of [`crate::frame::subgroups`] has passed.
    pub(super) subgroups_are_sound: AtomicBool,
    pub(super) pipeline_cache: PipelineCache,
    // Destroyed after the device, so it must be the last field.
    pub(super) owner: Owner,
}

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
    pub(super) fn is_foreign(&self) -> bool {
        matches!(self.owner, Owner::Host(_))
    }

    /// Returns the error of a failed call. Remembers a lost device.
    pub(super) fn failed(&self, call: &'static str, result: vk::Result) -> Error {
        self.lost.fetch_or(result == vk::Result::ERROR_DEVICE_LOST, Ordering::Relaxed);
        vk_error(call)(result)
    }

    pub(super) fn lock_queue(&self) -> Result<LockedQueue<'_>> {
        let Some(queue) = &self.queue else {
            let problem = "the host keeps its queue: only recording into its command buffers is possible";
            return Err(Error::argument("queue", problem));
        };
        Ok(LockedQueue::new(queue, self.queue_lock.as_deref()))
    }

    pub(super) fn queue_families(&self) -> Vec<vk::QueueFamilyProperties> {
        queue_families(self.owner.instance(), self.physical)
    }

    /// Records a barrier, outside of a render pass.
    pub(super) fn barrier(&self, commands: vk::CommandBuffer, dependency: &vk::DependencyInfo<'_>) {
        // SAFETY: the caller records into `commands`, and keeps the buffers and images of the barrier.
        unsafe { self.device.cmd_pipeline_barrier2(commands, dependency) }
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
            for timeline in self.copying.iter().flat_map(|queue| [&queue.worked, &queue.copied]) {
                self.device.destroy_semaphore(timeline.semaphore, None);
            }
            for layout in self.shared_layouts.iter().flatten() {
                self.device.destroy_descriptor_set_layout(*layout, None);
            }
        }
        self.pipeline_cache.close(&self.device);
    }
}

// A queue for copies only, on devices with such a queue family: uploads run beside the main queue's work.
//
// Each of the two queues counts its submissions in a timeline semaphore. A copy that must not overtake the main queue's
// work waits for that count. The main queue waits for the copy queue's count to acquire the copied data.

/// Semaphore that counts the submissions to a queue.
pub(super) struct Timeline {
    semaphore: vk::Semaphore,
    /// Submissions so far. Changed only under the queue's lock.
    count: AtomicU64,
}

impl Timeline {
    fn new(device: &RawDevice) -> Result<Self> {
        let mut kind = vk::SemaphoreTypeCreateInfo::default().semaphore_type(vk::SemaphoreType::TIMELINE);
        let info = vk::SemaphoreCreateInfo::default().push_next(&mut kind);
        // SAFETY: valid create info; timelineSemaphore is on in devices with a queue for copies.
        let semaphore = unsafe { device.create_semaphore(&info, None) };
        Ok(Self { semaphore: semaphore.map_err(vk_error("vkCreateSemaphore"))?, count: AtomicU64::new(0) })
    }

    /// Returns the wait for all submissions so far.
    pub(super) fn last(&self) -> vk::SemaphoreSubmitInfo<'static> {
        vk::SemaphoreSubmitInfo::default()
            .semaphore(self.semaphore)
            .value(self.count.load(Ordering::Acquire))
            .stage_mask(vk::PipelineStageFlags2::ALL_COMMANDS)
    }

    /// Returns the signal of the next submission.
    pub(super) fn next(&self) -> vk::SemaphoreSubmitInfo<'static> {
        let last = self.last();
        last.value(last.value + 1)
    }

    pub(super) fn submitted(&self) {
        self.count.fetch_add(1, Ordering::Release);
    }
}

/// The copy queue, with the timelines of both queues.
pub(super) struct CopyQueue {
    queue: Mutex<vk::Queue>,
    pub(super) family: u32,
    pub(super) worked: Timeline,
    pub(super) copied: Timeline,
}

impl CopyQueue {
    pub(super) fn new(device: &RawDevice, family: u32) -> Result<Self> {
        // SAFETY: the device was created with one queue of this family.
        let queue = Mutex::new(unsafe { device.get_device_queue(family, 0) });
        let worked = Timeline::new(device)?;
        let copied = Timeline::new(device).inspect_err(|_| {
            // SAFETY: it was made just now, and is not in use.
            unsafe { device.destroy_semaphore(worked.semaphore, None) }
        })?;
        Ok(Self { queue, family, worked, copied })
    }

    pub(super) fn lock(&self) -> LockedQueue<'_> {
        LockedQueue::new(&self.queue, None)
    }
}

// A queue locked for one thread, together with a host's lock of it.

/// A host's lock of the queue that it gives to a context, for hosts whose other threads submit to that queue: see
/// [`super::ForeignDevice::queue_lock`].
///
/// Operations that submit take it around each `vkQueueSubmit2`, and around a `vkQueueWaitIdle` after a wait has failed.
/// They do not hold it while waiting for the device, and recording never takes it. A thread that holds it must not call
/// anything that submits: it would deadlock.
///
/// # Safety
/// From the return of [`QueueLock::lock`] to the call of [`QueueLock::unlock`], on the same thread, nobody else uses the queue.
pub unsafe trait QueueLock: Send + Sync {
    /// Waits for the lock and takes it.
    fn lock(&self);

    /// Releases the lock.
    fn unlock(&self);
}

pub(super) struct LockedQueue<'a> {
    pub(super) queue: MutexGuard<'a, vk::Queue>,
    host: Option<&'a dyn QueueLock>,
}

impl<'a> LockedQueue<'a> {
    /// Takes the host's lock after our own, so that our threads wait for each other without holding it.
    fn new(queue: &'a Mutex<vk::Queue>, host: Option<&'a dyn QueueLock>) -> Self {
        let queue = lock(queue);
        if let Some(host) = host {
            host.lock();
        }
        Self { queue, host }
    }
}

impl Drop for LockedQueue<'_> {
    fn drop(&mut self) {
        if let Some(host) = self.host {
            host.unlock();
        }
    }
}
