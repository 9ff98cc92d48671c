//! Queues and semaphores: the machine's queues over the driver's only one, and the host's waits for them.
//!
//! Some queues' submissions are held back until needed ([`super::submissions`]). This reveals missing semaphores, and memory that the
//! host accesses too early, although the driver's queue runs everything in order.

use super::state::{Callbacks, DeviceState, in_chain, passed_on, slice};
use super::submissions::{Queue, QueueIndex, Submission, Submissions, Wait};
use ash::vk::{self, Handle};

impl Submissions {
    pub fn start_ready(&mut self, state: &DeviceState) -> vk::Result {
        while let Some(submission) = self.next() {
            let info = [vk::SubmitInfo2::default()
                .wait_semaphore_infos(&submission.waits)
                .command_buffer_infos(&submission.commands)
                .signal_semaphore_infos(&submission.signals)];
            // SAFETY: the program's submission, whose objects live until it is done; the lock gives the queue to this
            // thread.
            let result = unsafe { (state.v13.queue_submit2)(self.queue, 1, info.as_ptr(), submission.fence) };
            if result != vk::Result::SUCCESS {
                return result;
            }
        }
        vk::Result::SUCCESS
    }

    /// Same as [`Self::start_ready`], but for a single wait of the host.
    fn start_for(&mut self, state: &DeviceState, host_wait: Wait) -> vk::Result {
        self.host_waits.push(host_wait);
        let result = self.start_ready(state);
        self.host_waits.pop();
        result
    }

    /// Starts all submissions of a queue or of the device. Fails if one waits for a signal that was never submitted.
    fn finish(&mut self, state: &DeviceState, index: Option<QueueIndex>) -> vk::Result {
        let result = self.start_for(state, index.map_or(Wait::All, Wait::Queue));
        if result == vk::Result::SUCCESS && self.has(index) {
            eprintln!(
                "mock layer: the host waits for submissions that wait for a semaphore which nothing signals"
            );
            return vk::Result::ERROR_DEVICE_LOST;
        }
        result
    }

    fn add(&mut self, state: &DeviceState, index: QueueIndex, mut submission: Submission) {
        (submission.index, submission.is_late) = (index, state.machine.holds(index.0));
        if state.machine.forgets(index.0) {
            submission.waits.clear();
        }
        // Values of binary semaphores have no meaning.
        for of in submission.waits.iter_mut().chain(&mut submission.signals) {
            of.value = self.reached(of.semaphore).map_or(0, |_| of.value);
        }
        self.pending.push(submission);
    }
}

impl DeviceState {
    /// Waits for the driver on a host thread. Submissions of other threads take its wait into account.
    pub fn wait(&self, host_waits: &[Wait], wait: impl FnOnce() -> vk::Result) -> vk::Result {
        let mut submissions = self.submissions();
        submissions.host_waits.extend(host_waits);
        let mut result = submissions.start_ready(self);
        drop(submissions);
        if result == vk::Result::SUCCESS {
            result = wait();
        }
        let mut submissions = self.submissions();
        for host_wait in host_waits {
            if let Some(at) = submissions.host_waits.iter().position(|of| of == host_wait) {
                submissions.host_waits.swap_remove(at);
            }
        }
        result
    }

    /// Submits what a query of the host needs.
    pub fn start_needed_by(&self, host_wait: Wait) {
        let _ = self.submissions().start_for(self, host_wait);
    }

    /// Submits what the next value of a timeline semaphore needs.
    fn start_next_of(&self, semaphore: vk::Semaphore) {
        let reached = self.submissions().reached(semaphore);
        self.start_needed_by(Wait::Semaphore((semaphore, reached.unwrap_or_default() + 1)));
    }
}

fn index_of(queue: vk::Queue) -> QueueIndex {
    // SAFETY: handles of this layer's queues are addresses of its own objects, which live as long as the device.
    unsafe { (*(queue.as_raw() as usize as *const Queue)).index }
}

pub unsafe extern "system" fn get(device: vk::Device, family: u32, index: u32, queue: *mut vk::Queue) {
    let state = DeviceState::of(device);
    let mut submissions = state.submissions();
    // SAFETY: a device begins with the loader's table, which its queues share.
    let table = unsafe { *(device.as_raw() as usize as *const usize) };
    let index = (family, index);
    let found = submissions.queues.entry(index).or_insert_with(|| Box::new(Queue { table, index }));
    // SAFETY: the caller's location for a handle.
    unsafe { *queue = vk::Queue::from_raw((&raw mut **found) as usize as u64) }
}

pub unsafe extern "system" fn get2(
    device: vk::Device,
    info: *const vk::DeviceQueueInfo2<'_>,
    queue: *mut vk::Queue,
) {
    // SAFETY: the caller's arguments.
    unsafe { get(device, (*info).queue_family_index, (*info).queue_index, queue) }
}

/// Converts a submission of the older call. Its chain may hold values of timeline semaphores.
unsafe fn older(info: &vk::SubmitInfo<'_>) -> Submission {
    // SAFETY: the caller's arrays have these lengths.
    unsafe {
        let (mut wait_values, mut signal_values): (&[u64], &[u64]) = (&[], &[]);
        if let Some(values) = in_chain::<vk::TimelineSemaphoreSubmitInfo<'_>>(info.p_next).as_ref() {
            wait_values = slice(values.p_wait_semaphore_values, values.wait_semaphore_value_count);
            signal_values = slice(values.p_signal_semaphore_values, values.signal_semaphore_value_count);
        }
        let stages = slice(info.p_wait_dst_stage_mask, info.wait_semaphore_count);
        // The older stages are the lower bits of the newer ones.
        let stage = |at: usize| vk::PipelineStageFlags2::from_raw(stages[at].as_raw().into());
        let semaphore = |values: &[u64], at: usize, semaphore: vk::Semaphore, stage| {
            vk::SemaphoreSubmitInfo::default()
                .semaphore(semaphore)
                .value(values.get(at).copied().unwrap_or_default())
                .stage_mask(stage)
        };
        let buffer = |&of: &_| vk::CommandBufferSubmitInfo::default().command_buffer(of);
        let waits = slice(info.p_wait_semaphores, info.wait_semaphore_count).iter().enumerate();
        let commands = slice(info.p_command_buffers, info.command_buffer_count).iter();
        let signals = slice(info.p_signal_semaphores, info.signal_semaphore_count).iter().enumerate();
        let all = vk::PipelineStageFlags2::ALL_COMMANDS;
        Submission {
            waits: waits.map(|(at, &of)| semaphore(wait_values, at, of, stage(at))).collect(),
            commands: commands.map(buffer).collect(),
            signals: signals.map(|(at, &of)| semaphore(signal_values, at, of, all)).collect(),
            ..Submission::default()
        }
    }
}

/// Copies the lists of a submission; the copies hold no pointers.
unsafe fn newer(info: &vk::SubmitInfo2<'_>) -> Submission {
    let semaphore = |from: &vk::SemaphoreSubmitInfo<'_>| {
        vk::SemaphoreSubmitInfo::default()
            .semaphore(from.semaphore)
            .value(from.value)
            .stage_mask(from.stage_mask)
    };
    let buffer = |from: &vk::CommandBufferSubmitInfo<'_>| {
        vk::CommandBufferSubmitInfo::default().command_buffer(from.command_buffer)
    };
    // SAFETY: the caller's arrays have these lengths.
    unsafe {
        let waits = slice(info.p_wait_semaphore_infos, info.wait_semaphore_info_count);
        let commands = slice(info.p_command_buffer_infos, info.command_buffer_info_count);
        let signals = slice(info.p_signal_semaphore_infos, info.signal_semaphore_info_count);
        Submission {
            waits: waits.iter().map(semaphore).collect(),
            commands: commands.iter().map(buffer).collect(),
            signals: signals.iter().map(semaphore).collect(),
            ..Submission::default()
        }
    }
}

/// Adds the submissions of one call; the fence belongs to the last.
fn take(queue: vk::Queue, mut all: Vec<Submission>, fence: vk::Fence) -> vk::Result {
    let state = DeviceState::of(queue);
    if fence != vk::Fence::null() && all.is_empty() {
        all.push(Submission::default());
    }
    if let Some(last) = all.last_mut() {
        last.fence = fence;
    }
    let mut submissions = state.submissions();
    all.into_iter().for_each(|submission| submissions.add(&state, index_of(queue), submission));
    submissions.start_ready(&state)
}

pub unsafe extern "system" fn submit(
    queue: vk::Queue,
    count: u32,
    submits: *const vk::SubmitInfo<'_>,
    fence: vk::Fence,
) -> vk::Result {
    // SAFETY: the caller's arguments.
    let all = unsafe { slice(submits, count).iter().map(|info| older(info)).collect() };
    take(queue, all, fence)
}

pub unsafe extern "system" fn submit2(
    queue: vk::Queue,
    count: u32,
    submits: *const vk::SubmitInfo2<'_>,
    fence: vk::Fence,
) -> vk::Result {
    // SAFETY: the caller's arguments.
    let all = unsafe { slice(submits, count).iter().map(|info| newer(info)).collect() };
    take(queue, all, fence)
}

pub unsafe extern "system" fn wait_idle(queue: vk::Queue) -> vk::Result {
    let state = DeviceState::of(queue);
    let mut submissions = state.submissions();
    match submissions.finish(&state, Some(index_of(queue))) {
        // SAFETY: the lock gives the driver's queue to this thread.
        vk::Result::SUCCESS => unsafe { (state.v10.queue_wait_idle)(submissions.queue) },
        failure => failure,
    }
}

pub unsafe extern "system" fn device_wait_idle(device: vk::Device) -> vk::Result {
    let state = DeviceState::of(device);
    let mut submissions = state.submissions();
    match submissions.finish(&state, None) {
        // SAFETY: as above: the driver's one queue serves all.
        vk::Result::SUCCESS => unsafe { (state.v10.device_wait_idle)(device) },
        failure => failure,
    }
}

pub unsafe extern "system" fn present(queue: vk::Queue, info: *const vk::PresentInfoKHR<'_>) -> vk::Result {
    let state = DeviceState::of(queue);
    let mut submissions = state.submissions();
    match submissions.start_for(&state, Wait::All) {
        // SAFETY: as above.
        vk::Result::SUCCESS => unsafe { (state.swapchain.queue_present_khr)(submissions.queue, info) },
        failure => failure,
    }
}

pub unsafe extern "system" fn wait_for_fences(
    device: vk::Device,
    count: u32,
    fences: *const vk::Fence,
    all: vk::Bool32,
    timeout: u64,
) -> vk::Result {
    let state = DeviceState::of(device);
    // SAFETY: the caller's arguments.
    let host_waits: Vec<_> =
        unsafe { slice(fences, count).iter().map(|&fence| Wait::Fence(fence)).collect() };
    // SAFETY: as above.
    state.wait(&host_waits, || unsafe { (state.v10.wait_for_fences)(device, count, fences, all, timeout) })
}

passed_on! {
    fence_status(device: vk::Device, fence: vk::Fence) -> vk::Result,
        v10.get_fence_status, |state| state.start_needed_by(Wait::Fence(fence));
    // The layer does not know which submission sets the event, so it starts all.
    event_status(device: vk::Device, event: vk::Event) -> vk::Result,
        v10.get_event_status, |state| state.start_needed_by(Wait::All);
    destroy_semaphore(device: vk::Device, semaphore: vk::Semaphore, callbacks: Callbacks<'_>),
        v10.destroy_semaphore, |state| state.submissions().timelines.remove(&semaphore);
    // Each query starts what the next value needs, so that a polling host makes progress.
    semaphore_value(device: vk::Device, semaphore: vk::Semaphore, value: *mut u64) -> vk::Result,
        v12.get_semaphore_counter_value, |state| state.start_next_of(semaphore);
}

/// A pool of the driver's only family.
pub unsafe extern "system" fn create_command_pool(
    device: vk::Device,
    info: *const vk::CommandPoolCreateInfo<'_>,
    callbacks: Callbacks<'_>,
    pool: *mut vk::CommandPool,
) -> vk::Result {
    // SAFETY: the caller's arguments, passed on with another description.
    unsafe {
        let own = (*info).queue_family_index(0);
        (DeviceState::of(device).v10.create_command_pool)(device, &raw const own, callbacks, pool)
    }
}

pub unsafe extern "system" fn create_semaphore(
    device: vk::Device,
    info: *const vk::SemaphoreCreateInfo<'_>,
    callbacks: Callbacks<'_>,
    semaphore: *mut vk::Semaphore,
) -> vk::Result {
    let state = DeviceState::of(device);
    // SAFETY: the caller's arguments.
    unsafe {
        let result = (state.v10.create_semaphore)(device, info, callbacks, semaphore);
        if let Some(kind) = in_chain::<vk::SemaphoreTypeCreateInfo<'_>>((*info).p_next).as_ref()
            && result == vk::Result::SUCCESS
            && kind.semaphore_type == vk::SemaphoreType::TIMELINE
        {
            state.submissions().timelines.insert(*semaphore, kind.initial_value);
        }
        result
    }
}

pub unsafe extern "system" fn signal_semaphore(
    device: vk::Device,
    info: *const vk::SemaphoreSignalInfo<'_>,
) -> vk::Result {
    let state = DeviceState::of(device);
    // SAFETY: the caller's arguments.
    let (result, point) =
        unsafe { ((state.v12.signal_semaphore)(device, info), ((*info).semaphore, (*info).value)) };
    if result != vk::Result::SUCCESS {
        return result;
    }
    let mut submissions = state.submissions();
    submissions.signalled(point);
    submissions.start_ready(&state)
}

pub unsafe extern "system" fn wait_semaphores(
    device: vk::Device,
    info: *const vk::SemaphoreWaitInfo<'_>,
    timeout: u64,
) -> vk::Result {
    let state = DeviceState::of(device);
    // SAFETY: the caller's arguments.
    let host_waits: Vec<_> = unsafe {
        let semaphores = slice((*info).p_semaphores, (*info).semaphore_count).iter();
        let values = slice((*info).p_values, (*info).semaphore_count).iter();
        semaphores.zip(values).map(|(&semaphore, &value)| Wait::Semaphore((semaphore, value))).collect()
    };
    // SAFETY: as above.
    state.wait(&host_waits, || unsafe { (state.v12.wait_semaphores)(device, info, timeout) })
}

/// Defines functions of a queue that pass the driver's queue on instead, under the lock.
macro_rules! of_drivers_queue {
    ($($name:ident($($argument:ident: $kind:ty)?), $next:ident;)*) => {$(
        pub unsafe extern "system" fn $name(queue: vk::Queue $(, $argument: $kind)?) {
            let state = DeviceState::of(queue);
            // SAFETY: the caller's arguments; the lock gives the driver's queue to this thread.
            unsafe { (state.debug.$next)(state.submissions().queue $(, $argument)?) }
        }
    )*};
}

of_drivers_queue! {
    begin_label(label: *const vk::DebugUtilsLabelEXT<'_>), queue_begin_debug_utils_label_ext;
    insert_label(label: *const vk::DebugUtilsLabelEXT<'_>), queue_insert_debug_utils_label_ext;
    end_label(), queue_end_debug_utils_label_ext;
}

/// Drops names of the machine's queues: the driver has only one.
pub unsafe extern "system" fn name_object(
    device: vk::Device,
    info: *const vk::DebugUtilsObjectNameInfoEXT<'_>,
) -> vk::Result {
    // SAFETY: the caller's arguments.
    unsafe {
        if (*info).object_type == vk::ObjectType::QUEUE {
            return vk::Result::SUCCESS;
        }
        (DeviceState::of(device).debug.set_debug_utils_object_name_ext)(device, info)
    }
}
