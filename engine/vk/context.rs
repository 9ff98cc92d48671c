//! The context: an open device, with the logs that observe its recordings.

use super::audit::{self, Audit};
use super::commands::Pools;
use super::device::DeviceDescription;
use super::limits::Limits;
#[cfg(feature = "testing")]
use super::memory::Block;
use super::open_device::Device;
use super::pipeline::{Demands, Pipeline};
use super::profile::{self, Profile};
use super::staging::Staging;
use crate::{Error, Result};
use ash::vk;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError, Weak};

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
pub struct Context {
    pub(super) device: Arc<Device>,
    /// Idle command buffers.
    pub(super) pools: Arc<Pools>,
    pub(super) logs: Arc<Logs>,
    /// Staging memory of transfers, if device memory is not mapped.
    pub(super) staging: Arc<Staging>,
    /// If present, kernels are added to this list instead of being built.
    pub(super) jobs: Option<Jobs>,
}

/// Logs that observe a context.
#[derive(Default)]
pub(super) struct Logs {
    /// The profile that records every command, if one exists.
    pub(super) profile: Mutex<Weak<profile::Log>>,
    /// The audit that hashes the output of every command, if one exists.
    pub(super) audit: Mutex<Weak<audit::Log>>,
    /// Blocks of buffers with guard bands.
    #[cfg(feature = "testing")]
    pub(super) guarded: Mutex<Vec<Weak<Block>>>,
}

impl Context {
    /// Returns the context of a device that was just opened.
    pub(super) fn on(device: Arc<Device>) -> Self {
        let pools = Arc::new(Pools::new(device.clone()));
        Self { pools, logs: Arc::default(), staging: Arc::default(), jobs: None, device }
    }

    /// Returns the device's limits, as changed by the options.
    pub fn limits(&self) -> &Limits {
        &self.device.limits
    }

    /// True if ashsplat opened the device.
    pub(crate) fn owns_device(&self) -> bool {
        !self.device.is_foreign()
    }

    /// Set after the check of [`crate::subgroups`] has passed.
    pub(crate) fn subgroups_are_sound(&self) -> &AtomicBool {
        &self.device.subgroups_are_sound
    }

    /// True if submissions run: a host may keep its queue to itself, and a compile-only device runs nothing.
    pub(crate) fn can_run(&self) -> bool {
        self.device.queue.is_some() && self.device.executables.is_none()
    }

    /// Returns the driver's name of the device.
    pub fn device_name(&self) -> &str {
        &self.device.description.name
    }

    /// Returns the driver's description of the device. Its limits are not changed by the options.
    pub fn description(&self) -> &DeviceDescription {
        &self.device.description
    }

    /// True if the queue can also draw (VK_QUEUE_GRAPHICS_BIT). Copying depth images requires this.
    pub fn draws(&self) -> bool {
        let inner = &self.device;
        // SAFETY: the physical device is of this instance.
        let families =
            unsafe { inner.owner.instance().get_physical_device_queue_family_properties(inner.physical) };
        let own = families.get(inner.queue_family as usize);
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
            let queue = self.device.lock_queue()?;
            Ok(self.device.names.insert_queue_label(*queue, label))
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
        *self.logs.profile.lock().unwrap_or_else(PoisonError::into_inner) = log;
    }

    /// Turns timestamps off or on. Without them scopes are only labelled.
    pub fn set_timestamps(&self, on: bool) {
        self.device.timestamps.store(on, Ordering::Relaxed);
    }

    /// True if the device has timestamps.
    pub fn has_timestamps(&self) -> bool {
        self.device.timestamp_bits > 0
    }

    /// Hashes the outputs of all following commands, until the audit is dropped.
    pub fn audit(&self) -> Audit {
        let log = Arc::<audit::Log>::default();
        *self.logs.audit.lock().unwrap_or_else(PoisonError::into_inner) = Arc::downgrade(&log);
        Audit { log }
    }
}

// Kernels that are built ahead, on the host's threads.

/// A kernel that is not built yet. Any thread may build it, and threads may build several at once. All users of the device
/// share the built pipeline.
#[derive(Clone)]
pub struct KernelJob {
    device: Arc<Device>,
    pub(super) demands: Demands,
    pub(super) texels: bool,
    pub(super) spirv: &'static [u32],
    pub(super) constants: Vec<(u32, u32)>,
}

/// Jobs that are collected instead of being built.
pub(super) type Jobs = Arc<Mutex<Vec<KernelJob>>>;

impl KernelJob {
    /// Path of its shader below glsl/ without extension, "sort/sort_upsweep". Several kernels may have the same shader.
    pub fn name(&self) -> &'static str {
        self.demands.name
    }

    /// Builds it, or waits for the thread that builds it.
    ///
    /// # Errors
    /// When the driver refuses it.
    pub fn build(self) -> Result<()> {
        let form = (self.texels, None, self.spirv);
        Pipeline::shared(&self.device, &self.demands, form, self.constants).map(drop)
    }

    fn is(&self, other: &Self) -> bool {
        let key = |job: &Self| (job.demands.key(), job.texels);
        key(self) == key(other) && self.constants == other.constants
    }
}

impl Context {
    /// Returns the kernels that `build` would build. `build` may use its context only to build kernels.
    pub(crate) fn kernel_jobs(&self, build: impl FnOnce(&Context) -> Result<()>) -> Result<Vec<KernelJob>> {
        let jobs = Jobs::default();
        build(&Context { jobs: Some(jobs.clone()), ..self.clone() })?;
        let mut list = jobs.lock().unwrap_or_else(PoisonError::into_inner);
        Ok(std::mem::take(&mut *list))
    }

    /// Adds a kernel to the jobs if they are collected. None: the caller builds it now.
    pub(super) fn collect_job(
        &self,
        demands: &Demands,
        (texels, spirv): (bool, &'static [u32]),
        constants: &[(u32, u32)],
    ) -> Option<Pipeline> {
        let jobs = self.jobs.as_ref()?;
        let (device, demands) = (self.device.clone(), demands.clone());
        let job = KernelJob { device, demands, texels, spirv, constants: constants.to_vec() };
        let pipeline = Pipeline::never_built(&self.device, &job.demands);
        let mut jobs = jobs.lock().unwrap_or_else(PoisonError::into_inner);
        if !jobs.iter().any(|other| other.is(&job)) {
            jobs.push(job);
        }
        Some(pipeline)
    }
}
