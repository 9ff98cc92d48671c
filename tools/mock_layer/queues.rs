//! Queues and semaphores: the machine's queues over the driver's only one, and the host's waits for them.
//!
//! Some queues' submissions are held back until needed ([`super::held`]). This reveals missing semaphores, and memory that the
//! host accesses too early, although the driver's queue runs everything in order.

use super::held::{Held, Place, Queue, Submissions, Want};
use super::state::{Callbacks, DeviceState, in_chain, passed_on, slice};
use ash::vk::{self, Handle};

impl Submissions {
    /// Submits all submissions that may start now.
    pub fn go_on(&mut self, state: &DeviceState) -> vk::Result {
        while let Some(held) = self.next() {
            let info = [vk::SubmitInfo2::default()
                .wait_semaphore_infos(&held.waits)
                .command_buffer_infos(&held.commands)
                .signal_semaphore_infos(&held.signals)];
            // SAFETY: the program's submission, whose objects live until it is done; the lock gives the queue to this
            // thread.
            let result = unsafe { (state.v13.queue_submit2)(self.queue, 1, info.as_ptr(), held.fence) };
            if result != vk::Result::SUCCESS {
                return result;
            }
        }
        vk::Result::SUCCESS
    }

    /// Same as [`Self::go_on`], but for a single wait of the host.
    fn go_on_for(&mut self, state: &DeviceState, want: Want) -> vk::Result {
        self.wants.push(want);
        let result = self.go_on(state);
        self.wants.pop();
        result
    }

    /// Starts all submissions of a queue or of the device. Fails if one waits for a signal that was never submitted.
    fn finish(&mut self, state: &DeviceState, place: Option<Place>) -> vk::Result {
        let result = self.go_on_for(state, place.map_or(Want::All, Want::Queue));
        if result == vk::Result::SUCCESS && self.has(place) {
            eprintln!(
                "mock layer: the host waits for submissions that wait for a semaphore which nothing signals"
            );
            return vk::Result::ERROR_DEVICE_LOST;
        }
        result
    }

    /// Adds a submission of the program.
    fn add(&mut self, state: &DeviceState, place: Place, mut held: Held) {
        (held.place, held.late) = (place, state.machine.holds(place.0));
        if state.machine.forgets(place.0) {
            held.waits.clear();
        }
        // Values of binary semaphores have no meaning.
        for of in held.waits.iter_mut().chain(&mut held.signals) {
            of.value = self.reached(of.semaphore).map_or(0, |_| of.value);
        }
        self.held.push(held);
    }
}

impl DeviceState {
    /// Waits for the driver on a host thread. Submissions of other threads take its wait into account.
    pub fn wait(&self, wants: &[Want], wait: impl FnOnce() -> vk::Result) -> vk::Result {
        let mut submissions = self.submissions();
        submissions.wants.extend(wants);
        let mut result = submissions.go_on(self);
        drop(submissions);
        if result == vk::Result::SUCCESS {
            result = wait();
        }
        let mut submissions = self.submissions();
        for want in wants {
            if let Some(at) = submissions.wants.iter().position(|of| of == want) {
                submissions.wants.swap_remove(at);
            }
        }
        result
    }

    /// Submits what a query of the host needs.
    pub fn ask(&self, want: Want) {
        let _ = self.submissions().go_on_for(self, want);
    }

    /// Submits what the next value of a timeline semaphore needs.
    fn ask_for_next(&self, semaphore: vk::Semaphore) {
        let reached = self.submissions().reached(semaphore);
        self.ask(Want::Point((semaphore, reached.unwrap_or_default() + 1)));
    }
}

fn place_of(queue: vk::Queue) -> Place {
    // SAFETY: handles of this layer's queues are addresses of its own objects, which live as long as the device.
    unsafe { (*(queue.as_raw() as usize as *const Queue)).place }
}

pub unsafe extern "system" fn get(device: vk::Device, family: u32, index: u32, queue: *mut vk::Queue) {
    let state = DeviceState::of(device);
    let mut submissions = state.submissions();
    // SAFETY: a device begins with the loader's table, which its queues share.
    let table = unsafe { *(device.as_raw() as usize as *const usize) };
    let place = (family, index);
    let found = submissions.queues.entry(place).or_insert_with(|| Box::new(Queue { table, place }));
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
unsafe fn older(info: &vk::SubmitInfo<'_>) -> Held {
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
        Held {
            waits: waits.map(|(at, &of)| semaphore(wait_values, at, of, stage(at))).collect(),
            commands: commands.map(buffer).collect(),
            signals: signals.map(|(at, &of)| semaphore(signal_values, at, of, all)).collect(),
            ..Held::default()
        }
    }
}

/// Copies the lists of a submission; the copies hold no pointers.
unsafe fn newer(info: &vk::SubmitInfo2<'_>) -> Held {
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
        Held {
            waits: waits.iter().map(semaphore).collect(),
            commands: commands.iter().map(buffer).collect(),
            signals: signals.iter().map(semaphore).collect(),
            ..Held::default()
        }
    }
}

/// Adds the submissions of one call; the fence belongs to the last.
fn take(queue: vk::Queue, mut all: Vec<Held>, fence: vk::Fence) -> vk::Result {
    let state = DeviceState::of(queue);
    if fence != vk::Fence::null() && all.is_empty() {
        all.push(Held::default());
    }
    if let Some(last) = all.last_mut() {
        last.fence = fence;
    }
    let mut submissions = state.submissions();
    all.into_iter().for_each(|held| submissions.add(&state, place_of(queue), held));
    submissions.go_on(&state)
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
    match submissions.finish(&state, Some(place_of(queue))) {
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
    match submissions.go_on_for(&state, Want::All) {
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
    let wants: Vec<_> = unsafe { slice(fences, count).iter().map(|&fence| Want::Fence(fence)).collect() };
    // SAFETY: as above.
    state.wait(&wants, || unsafe { (state.v10.wait_for_fences)(device, count, fences, all, timeout) })
}

passed_on! {
    fence_status(device: vk::Device, fence: vk::Fence) -> vk::Result,
        v10.get_fence_status, |state| state.ask(Want::Fence(fence));
    // The layer does not know which submission sets the event, so it starts all.
    event_status(device: vk::Device, event: vk::Event) -> vk::Result,
        v10.get_event_status, |state| state.ask(Want::All);
    destroy_semaphore(device: vk::Device, semaphore: vk::Semaphore, callbacks: Callbacks<'_>),
        v10.destroy_semaphore, |state| state.submissions().timelines.remove(&semaphore);
    // Each query starts what the next value needs, so that a polling host makes progress.
    semaphore_value(device: vk::Device, semaphore: vk::Semaphore, value: *mut u64) -> vk::Result,
        v12.get_semaphore_counter_value, |state| state.ask_for_next(semaphore);
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
    submissions.go_on(&state)
}

pub unsafe extern "system" fn wait_semaphores(
    device: vk::Device,
    info: *const vk::SemaphoreWaitInfo<'_>,
    timeout: u64,
) -> vk::Result {
    let state = DeviceState::of(device);
    // SAFETY: the caller's arguments.
    let wants: Vec<_> = unsafe {
        let semaphores = slice((*info).p_semaphores, (*info).semaphore_count).iter();
        let values = slice((*info).p_values, (*info).semaphore_count).iter();
        semaphores.zip(values).map(|(&semaphore, &value)| Want::Point((semaphore, value))).collect()
    };
    // SAFETY: as above.
    state.wait(&wants, || unsafe { (state.v12.wait_semaphores)(device, info, timeout) })
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
