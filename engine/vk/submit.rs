//! Command buffers, submission and waiting.

use super::audit;
use super::context::{Context, Inner};
use super::descriptors::DescriptorSets;
use super::image::Image;
use super::kernel::Pipeline;
use super::memory::Block;
use super::profile::{self, HostTimes};
use super::profiler::{MAX_SCOPES, Profiler, QUERIES, ScopeTime};
use super::recorder::Recorder;
use super::vk_error;
use crate::{Error, Result};
use ash::vk;
use std::sync::atomic::Ordering;
use std::sync::{Arc, PoisonError};
use std::time::{Duration, Instant};

/// Device times of a submission.
#[derive(Clone, Debug, Default)]
#[non_exhaustive]
pub struct RunReport {
    /// Each [`Recorder::scope`] in the order of recording. Empty without timestamps.
    pub scopes: Vec<ScopeTime>,
    /// The whole recording on the device, nanoseconds. 0 without timestamps.
    pub nanoseconds: f64,
}

/// The Vulkan objects of one recording, reused after it.
#[derive(Clone, Copy)]
pub(super) struct Objects {
    pool: vk::CommandPool,
    commands: vk::CommandBuffer,
    fence: vk::Fence,
    queries: vk::QueryPool,
}

impl Objects {
    fn new(inner: &Inner) -> Result<Self> {
        let null = Self {
            pool: vk::CommandPool::null(),
            commands: vk::CommandBuffer::null(),
            fence: vk::Fence::null(),
            queries: vk::QueryPool::null(),
        };
        let mut objects = null;
        objects.create(inner).inspect_err(|_| objects.destroy(inner))?;
        Ok(objects)
    }

    fn create(&mut self, inner: &Inner) -> Result<()> {
        let device = &inner.device;
        let pool = vk::CommandPoolCreateInfo::default()
            .queue_family_index(inner.queue_family)
            .flags(vk::CommandPoolCreateFlags::TRANSIENT);
        // SAFETY: valid create infos for this device.
        unsafe {
            self.pool = device.create_command_pool(&pool, None).map_err(vk_error("vkCreateCommandPool"))?;
            let commands = vk::CommandBufferAllocateInfo::default()
                .command_pool(self.pool)
                .level(vk::CommandBufferLevel::PRIMARY)
                .command_buffer_count(1);
            let commands = device.allocate_command_buffers(&commands);
            let commands = commands.map_err(vk_error("vkAllocateCommandBuffers"))?;
            self.commands = commands.first().copied().unwrap_or_default();
            let fence = device.create_fence(&vk::FenceCreateInfo::default(), None);
            self.fence = fence.map_err(vk_error("vkCreateFence"))?;
            if inner.timestamp_bits > 0 {
                let queries = vk::QueryPoolCreateInfo::default()
                    .query_type(vk::QueryType::TIMESTAMP)
                    .query_count(QUERIES);
                let queries = device.create_query_pool(&queries, None);
                self.queries = queries.map_err(vk_error("vkCreateQueryPool"))?;
                inner.names.name(self.queries, "scope timestamps");
            }
        }
        inner.names.name(self.pool, "recorder pool");
        inner.names.name(self.fence, "recorder fence");
        Ok(())
    }

    pub(super) fn destroy(&self, inner: &Inner) {
        // SAFETY: they are idle; null handles are allowed. Destroying the pool frees its command buffer.
        unsafe {
            inner.device.destroy_query_pool(self.queries, None);
            inner.device.destroy_fence(self.fence, None);
            inner.device.destroy_command_pool(self.pool, None);
        }
    }
}

/// A command buffer in the recording state or submitted. Returns to the context when dropped.
pub(super) struct Commands {
    pub(super) inner: Arc<Inner>,
    objects: Objects,
    submitted: bool,
    pub(super) descriptors: Option<DescriptorSets>,
}

impl Commands {
    /// With `every_command`, there are queries for each command too.
    pub(super) fn begin(inner: &Arc<Inner>, label: &str, every_command: bool) -> Result<Self> {
        let free = inner.idle_objects.lock().unwrap_or_else(PoisonError::into_inner).pop();
        let objects = match free {
            Some(objects) => objects,
            None => Objects::new(inner)?,
        };
        let sets = inner.descriptors.lock().unwrap_or_else(PoisonError::into_inner).pop();
        let descriptors = sets.or_else(|| DescriptorSets::new(inner));
        let commands = Self { inner: inner.clone(), objects, submitted: false, descriptors };
        inner.names.name(objects.commands, label);
        let info = vk::CommandBufferBeginInfo::default().flags(vk::CommandBufferUsageFlags::ONE_TIME_SUBMIT);
        // SAFETY: the command buffer is in the initial state (new, or its pool was reset) and this thread's alone; the
        // queries are not in use.
        unsafe {
            let begun = inner.device.begin_command_buffer(objects.commands, &info);
            begun.map_err(vk_error("vkBeginCommandBuffer"))?;
            if objects.queries != vk::QueryPool::null() {
                let count = if every_command { QUERIES } else { 2 * MAX_SCOPES };
                inner.device.cmd_reset_query_pool(objects.commands, objects.queries, 0, count);
            }
        }
        // Makes the writes of earlier submissions visible, including those that were not waited for.
        let earlier = vk::MemoryBarrier2::default()
            .src_stage_mask(vk::PipelineStageFlags2::ALL_COMMANDS)
            .src_access_mask(vk::AccessFlags2::MEMORY_WRITE)
            .dst_stage_mask(vk::PipelineStageFlags2::ALL_COMMANDS)
            .dst_access_mask(vk::AccessFlags2::MEMORY_READ | vk::AccessFlags2::MEMORY_WRITE);
        commands.memory_barrier(earlier);
        Ok(commands)
    }

    pub(super) fn raw(&self) -> vk::CommandBuffer {
        self.objects.commands
    }

    /// Null without timestamps, or if none are requested.
    pub(super) fn queries(&self) -> vk::QueryPool {
        let wanted = self.inner.timestamps.load(Ordering::Relaxed);
        if wanted { self.objects.queries } else { vk::QueryPool::null() }
    }

    fn memory_barrier(&self, barrier: vk::MemoryBarrier2<'_>) {
        let barriers = [barrier];
        let dependency = vk::DependencyInfo::default().memory_barriers(&barriers);
        // SAFETY: the command buffer is in the recording state.
        unsafe { self.inner.device.cmd_pipeline_barrier2(self.objects.commands, &dependency) }
    }

    pub(super) fn submit(&mut self) -> Result<()> {
        // A fence alone does not make writes visible to the host.
        let to_host = vk::MemoryBarrier2::default()
            .src_stage_mask(vk::PipelineStageFlags2::ALL_COMMANDS)
            .src_access_mask(vk::AccessFlags2::MEMORY_WRITE)
            .dst_stage_mask(vk::PipelineStageFlags2::HOST)
            .dst_access_mask(vk::AccessFlags2::HOST_READ | vk::AccessFlags2::HOST_WRITE);
        self.memory_barrier(to_host);
        let device = &self.inner.device;
        let buffers = [vk::CommandBufferSubmitInfo::default().command_buffer(self.objects.commands)];
        let submits = [vk::SubmitInfo2::default().command_buffer_infos(&buffers)];
        let queue = self.inner.lock_queue()?;
        // SAFETY: the command buffer was recorded on this device and everything that it refers to is kept by the
        // caller until the fence has signalled; the lock gives the queue to this thread.
        unsafe {
            let ended = device.end_command_buffer(self.objects.commands);
            ended.map_err(vk_error("vkEndCommandBuffer"))?;
            let submitted = device.queue_submit2(*queue, &submits, self.objects.fence);
            submitted.map_err(|error| self.inner.failed("vkQueueSubmit2", error))?;
        }
        self.submitted = true;
        Ok(())
    }

    /// Sleeps until the submission has finished, or until the timeout.
    pub(super) fn wait(&mut self, timeout: Option<Duration>) -> Result<()> {
        const ROUND: Duration = Duration::from_secs(60);
        let mut waited = Duration::ZERO;
        while self.submitted {
            let round = timeout.map_or(ROUND, |timeout| timeout.saturating_sub(waited).min(ROUND));
            let fences = [self.objects.fence];
            // SAFETY: the fence is alive and was submitted.
            let over = unsafe { self.inner.device.wait_for_fences(&fences, true, round.as_nanos() as u64) };
            match over {
                Ok(()) => self.submitted = false,
                Err(vk::Result::TIMEOUT) => {
                    waited += round;
                    if timeout.is_some_and(|timeout| waited >= timeout) {
                        return Err(Error::Timeout { seconds: waited.as_secs_f64() });
                    }
                }
                Err(error) => {
                    // A lost device runs nothing any more; after other errors that is unknown.
                    self.submitted = error != vk::Result::ERROR_DEVICE_LOST;
                    return Err(self.inner.failed("vkWaitForFences", error));
                }
            }
        }
        Ok(())
    }

    /// Waits until nothing of the submission runs any more, also after errors.
    fn settle(&mut self) {
        if self.wait(None).is_err() && self.submitted {
            if let Ok(queue) = self.inner.lock_queue() {
                // The queue alone: of a host's device, others are in use by other threads.
                // SAFETY: the lock gives the queue to this thread. When this fails, the device is lost.
                let _ = unsafe { self.inner.device.queue_wait_idle(*queue) };
            }
            self.submitted = false;
        }
    }
}

impl Drop for Commands {
    fn drop(&mut self) {
        self.settle();
        if let Some(mut sets) = self.descriptors.take() {
            sets.reset();
            self.inner.descriptors.lock().unwrap_or_else(PoisonError::into_inner).push(sets);
        }
        let device = &self.inner.device;
        // SAFETY: none of the objects is in use: it was never submitted, or has been waited for.
        let reset = unsafe {
            device
                .reset_command_pool(self.objects.pool, vk::CommandPoolResetFlags::empty())
                .and_then(|()| device.reset_fences(&[self.objects.fence]))
        };
        match reset {
            Ok(()) => {
                self.inner.idle_objects.lock().unwrap_or_else(PoisonError::into_inner).push(self.objects)
            }
            Err(_) => self.objects.destroy(&self.inner),
        }
    }
}

impl Inner {
    /// The error of a failed call. Remembers a lost device.
    pub(super) fn failed(&self, call: &'static str, result: vk::Result) -> Error {
        self.lost.fetch_or(result == vk::Result::ERROR_DEVICE_LOST, Ordering::Relaxed);
        vk_error(call)(result)
    }
}

/// All resources of a recording.
#[derive(Default)]
pub(super) struct Kept {
    blocks: Vec<Arc<Block>>,
    pipelines: Vec<Arc<Pipeline>>,
    images: Vec<Image>,
}

impl Kept {
    pub(super) fn block(&mut self, block: &Arc<Block>) {
        if !self.blocks.iter().rev().any(|b| Arc::ptr_eq(b, block)) {
            self.blocks.push(block.clone());
        }
    }

    pub(super) fn image(&mut self, image: &Image) {
        if !self.images.iter().rev().any(|i| i.id() == image.id()) {
            self.images.push(image.clone());
        }
    }

    /// Releases all resources, and keeps the lists' own memory. Resources without another holder are
    /// destroyed.
    pub(super) fn clear(&mut self) {
        self.blocks.clear();
        self.pipelines.clear();
        self.images.clear();
    }

    pub(super) fn pipeline(&mut self, pipeline: &Arc<Pipeline>) {
        if !self.pipelines.iter().rev().any(|p| Arc::ptr_eq(p, pipeline)) {
            self.pipelines.push(pipeline.clone());
        }
    }
}

/// A running submission. Dropping it waits as well.
#[must_use = "the results are there only after wait()"]
pub struct Pending {
    // Dropped in this order: the wait must come before the memory is freed.
    commands: Commands,
    profiler: Option<Profiler>,
    audit: Option<audit::Commands>,
    label: String,
    submitting: Instant,
    submitted: Instant,
    kept: Kept,
}

impl Pending {
    /// Sleeps until the device has finished; then its results may be read.
    ///
    /// # Errors
    /// [`Error::DeviceLost`]; [`Error::Timeout`] after [`super::ContextOptions::timeout`]: a thread then
    /// waits for the submission, and its resources remain in use until it has finished.
    pub fn wait(mut self) -> Result<RunReport> {
        let timeout = self.commands.inner.timeout;
        if let Err(error) = self.commands.wait(timeout) {
            if self.commands.submitted {
                // If no thread can be spawned, the closure is dropped, which waits here.
                let _ = std::thread::Builder::new().name("late submission".into()).spawn(move || drop(self));
            }
            return Err(error);
        }
        let done = Instant::now();
        if let Some(mut audit) = self.audit.take() {
            audit.log()?;
        }
        let Some(mut profiler) = self.profiler.take() else { return Ok(RunReport::default()) };
        let inner = &self.commands.inner;
        // The results are valid even if the times cannot be read.
        let collected = profiler.collect(inner).unwrap_or_default();
        let report = RunReport {
            scopes: collected.scopes.clone(),
            nanoseconds: collected.nanoseconds.unwrap_or_default(),
        };
        if let Some(commands) = profiler.commands {
            let host = HostTimes { submitting: self.submitting, submitted: self.submitted, done };
            commands.log(inner, std::mem::take(&mut self.label), host, collected);
        }
        Ok(report)
    }
}

impl Drop for Pending {
    fn drop(&mut self) {
        self.commands.settle();
        for block in &self.kept.blocks {
            block.in_flight.fetch_sub(1, Ordering::Release);
        }
    }
}

impl Context {
    /// Starts a recording under a label. Dropping the recorder discards it.
    ///
    /// # Errors
    /// [`Error::Vulkan`] when the driver has no memory left, [`Error::DeviceLost`].
    pub fn begin(&self, label: &str) -> Result<Recorder> {
        if self.is_lost() {
            return Err(Error::DeviceLost { call: "an earlier call" });
        }
        let profiled = profile::Commands::begin(&self.0)?;
        let commands = Commands::begin(&self.0, label, profiled.is_some())?;
        Ok(Recorder::new(commands, label, profiled, audit::Commands::begin(&self.0, label)))
    }

    /// Submits a recording. Wait for the [`Pending`] before using its results.
    ///
    /// # Errors
    /// [`Error::DeviceLost`], [`Error::Vulkan`] when out of memory, also if that happened while recording.
    ///
    /// # Panics
    /// When the recorder records into a foreign command buffer.
    pub fn submit(&self, mut recorder: Recorder) -> Result<Pending> {
        let submitting = Instant::now();
        recorder.check()?;
        let (commands, profiler, kept, audit) = recorder.finish();
        let label = profiler.label();
        let mut pending = Pending {
            commands,
            profiler: Some(profiler),
            audit,
            label,
            submitting,
            submitted: submitting,
            kept,
        };
        for block in &pending.kept.blocks {
            block.in_flight.fetch_add(1, Ordering::Release);
        }
        pending.commands.submit()?;
        pending.submitted = Instant::now();
        Ok(pending)
    }

    /// Records, submits and waits.
    ///
    /// # Errors
    /// What `record` returns (nothing is submitted then), and as [`Context::submit`] and [`Pending::wait`].
    pub fn run(&self, label: &str, record: impl FnOnce(&mut Recorder) -> Result<()>) -> Result<RunReport> {
        let mut recorder = self.begin(label)?;
        record(&mut recorder)?;
        self.submit(recorder)?.wait()
    }
}
