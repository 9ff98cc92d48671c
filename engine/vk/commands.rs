//! Records, submits, awaits and reuses command buffers.

use super::debug::vk_error;
use super::lock::lock;
use super::open_device::{CopyQueue, Device, LockedQueue};
use super::pipeline::DescriptorSets;
use super::profile::QUERIES;
use crate::error::{Error, Result};
use ash::vk;
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// Vulkan objects of one recording, reused for later ones.
#[derive(Clone, Copy, Default)]
struct Slot {
    pool: vk::CommandPool,
    commands: vk::CommandBuffer,
    fence: vk::Fence,
    queries: vk::QueryPool,
}

impl Slot {
    fn new(inner: &Device, family: u32, timed: bool) -> Result<Self> {
        let mut slot = Self::default();
        slot.create(inner, family, timed).inspect_err(|_| slot.destroy(inner))?;
        Ok(slot)
    }

    fn create(&mut self, inner: &Device, family: u32, timed: bool) -> Result<()> {
        let device = &inner.device;
        let pool = vk::CommandPoolCreateInfo::default()
            .queue_family_index(family)
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
        }
        if timed {
            self.queries = inner.create_queries(QUERIES, "scope timestamps")?;
        }
        inner.names.name(self.pool, "recorder pool");
        inner.names.name(self.fence, "recorder fence");
        Ok(())
    }

    fn destroy(&self, inner: &Device) {
        // SAFETY: the slot is idle; null handles are allowed. Destroying the pool frees its command buffer.
        unsafe {
            inner.device.destroy_query_pool(self.queries, None);
            inner.device.destroy_fence(self.fence, None);
            inner.device.destroy_command_pool(self.pool, None);
        }
    }
}

/// Idle objects of recordings. Every recording keeps the pools alive.
pub(super) struct Pools {
    pub(super) device: Arc<Device>,
    /// Slots of the main queue and of the copy queue.
    slots: [Mutex<Vec<Slot>>; 2],
    /// Descriptor sets, on devices without push descriptors.
    descriptors: Mutex<Vec<DescriptorSets>>,
}

impl Pools {
    pub(super) fn new(device: Arc<Device>) -> Self {
        Self { device, slots: Default::default(), descriptors: Mutex::default() }
    }
}

impl Drop for Pools {
    fn drop(&mut self) {
        // All slots are idle: `Commands` waits for its submission before it returns a slot.
        for slots in &self.slots {
            lock(slots).iter().for_each(|slot| slot.destroy(&self.device));
        }
    }
}

/// A command buffer, being recorded or submitted. Dropping it returns it to its pools.
pub(super) struct Commands {
    pub(super) pools: Arc<Pools>,
    pub(super) inner: Arc<Device>,
    slot: Slot,
    copies: bool,
    pub(super) submitted: bool,
    pub(super) descriptors: Option<DescriptorSets>,
}

impl Commands {
    /// Begins a recording for the copy queue, or else for the main queue. It has `queries` for timestamps, if the device does.
    pub(super) fn begin(
        pools: &Arc<Pools>,
        copying: Option<&CopyQueue>,
        label: &str,
        queries: u32,
    ) -> Result<Self> {
        let (inner, copies) = (&pools.device, copying.is_some());
        let family = copying.map_or(inner.queue_family, |copying| copying.family);
        let free = lock(&pools.slots[usize::from(copies)]).pop();
        let slot = free.map_or_else(|| Slot::new(inner, family, !copies), Ok)?;
        let free = || lock(&pools.descriptors).pop();
        let descriptors = if copies { None } else { free().or_else(|| DescriptorSets::new(inner)) };
        let (pools, own) = (pools.clone(), inner.clone());
        let commands = Self { pools, inner: own, slot, copies, submitted: false, descriptors };
        inner.names.name(slot.commands, label);
        let info = vk::CommandBufferBeginInfo::default().flags(vk::CommandBufferUsageFlags::ONE_TIME_SUBMIT);
        // SAFETY: the command buffer is in the initial state (new, or its pool was reset) and this thread's alone; the
        // queries are not in use.
        unsafe {
            let begun = inner.device.begin_command_buffer(slot.commands, &info);
            begun.map_err(vk_error("vkBeginCommandBuffer"))?;
            if queries > 0 && slot.queries != vk::QueryPool::null() {
                inner.device.cmd_reset_query_pool(slot.commands, slot.queries, 0, queries);
            }
        }
        // Makes the writes of all earlier submissions visible, including those not waited for.
        let all = vk::AccessFlags2::MEMORY_READ | vk::AccessFlags2::MEMORY_WRITE;
        commands.barrier_after_all(vk::PipelineStageFlags2::ALL_COMMANDS, all);
        Ok(commands)
    }

    pub(super) fn raw(&self) -> vk::CommandBuffer {
        self.slot.commands
    }

    /// Returns the query pool; null if the device has no timestamps or they are turned off.
    pub(super) fn queries(&self) -> vk::QueryPool {
        let wanted = self.inner.timestamps.load(Ordering::Relaxed);
        if wanted { self.slot.queries } else { vk::QueryPool::null() }
    }

    /// Makes all writes visible to these accesses.
    fn barrier_after_all(&self, stages: vk::PipelineStageFlags2, accesses: vk::AccessFlags2) {
        let barrier = vk::MemoryBarrier2::default()
            .src_stage_mask(vk::PipelineStageFlags2::ALL_COMMANDS)
            .src_access_mask(vk::AccessFlags2::MEMORY_WRITE)
            .dst_stage_mask(stages)
            .dst_access_mask(accesses);
        self.inner.barrier(self.slot.commands, &vk::DependencyInfo::default().memory_barriers(&[barrier]));
    }

    /// Orders accesses to a range of a buffer, or transfers it to another queue family.
    pub(super) fn buffer_barrier(&mut self, barrier: vk::BufferMemoryBarrier2<'_>) {
        let dependency = vk::DependencyInfo::default();
        self.inner.barrier(self.slot.commands, &dependency.buffer_memory_barriers(&[barrier]));
    }

    fn lock_queue(&self) -> Result<LockedQueue<'_>> {
        match self.inner.copying.as_ref().filter(|_| self.copies) {
            Some(copying) => Ok(copying.lock()),
            None => self.inner.lock_queue(),
        }
    }

    /// Submits, to run after a point of the other queue's timeline.
    pub(super) fn submit(&mut self, after: Option<vk::SemaphoreSubmitInfo<'static>>) -> Result<()> {
        // A fence alone does not make writes visible to the host.
        let host = vk::AccessFlags2::HOST_READ | vk::AccessFlags2::HOST_WRITE;
        self.barrier_after_all(vk::PipelineStageFlags2::HOST, host);
        let device = &self.inner.device;
        let buffers = [vk::CommandBufferSubmitInfo::default().command_buffer(self.slot.commands)];
        let queue = self.lock_queue()?;
        let copying = self.inner.copying.as_ref();
        let timeline = copying.map(|copying| if self.copies { &copying.copied } else { &copying.worked });
        let done = timeline.map(|timeline| timeline.next());
        let submits = [vk::SubmitInfo2::default()
            .command_buffer_infos(&buffers)
            .wait_semaphore_infos(after.as_slice())
            .signal_semaphore_infos(done.as_slice())];
        // SAFETY: the command buffer was recorded on this device and everything that it refers to is kept by the
        // caller until the fence has signalled; the lock gives the queue to this thread.
        unsafe {
            let ended = device.end_command_buffer(self.slot.commands);
            ended.map_err(vk_error("vkEndCommandBuffer"))?;
            let submitted = device.queue_submit2(*queue.queue, &submits, self.slot.fence);
            submitted.map_err(|error| self.inner.failed("vkQueueSubmit2", error))?;
        }
        if let Some(timeline) = timeline {
            timeline.submitted();
        }
        drop(queue);
        self.submitted = true;
        Ok(())
    }

    /// Waits until the submission has finished, or until the timeout.
    pub(super) fn wait(&mut self, timeout: Option<Duration>) -> Result<()> {
        const ROUND: Duration = Duration::from_secs(60);
        let mut waited = Duration::ZERO;
        while self.submitted {
            let round = timeout.map_or(ROUND, |timeout| timeout.saturating_sub(waited).min(ROUND));
            let fences = [self.slot.fence];
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

    /// Waits until nothing of the submission runs any more, even after errors.
    pub(super) fn settle(&mut self) {
        if self.wait(None).is_err() && self.submitted {
            if let Ok(queue) = self.lock_queue() {
                // Waits for this queue only: other threads may use other queues of a host's device.
                // SAFETY: the lock gives the queue to this thread. When this fails, the device is lost.
                let _ = unsafe { self.inner.device.queue_wait_idle(*queue.queue) };
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
            lock(&self.pools.descriptors).push(sets);
        }
        let device = &self.inner.device;
        // SAFETY: nothing of the slot is in use: it was never submitted, or has been waited for.
        let reset = unsafe {
            device
                .reset_command_pool(self.slot.pool, vk::CommandPoolResetFlags::empty())
                .and_then(|()| device.reset_fences(&[self.slot.fence]))
        };
        match reset {
            Ok(()) => lock(&self.pools.slots[usize::from(self.copies)]).push(self.slot),
            Err(_) => self.slot.destroy(&self.inner),
        }
    }
}
