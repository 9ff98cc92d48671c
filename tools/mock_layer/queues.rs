//! Queues: those of the machine over the driver's one.
//!
//! Submissions to a queue for copies are held back until the host waits for anything, or another submission waits for a
//! semaphore of theirs. So a missing semaphore or a staging memory that is written too early shows, although one queue of the
//! driver's runs everything in order.

use super::state::DeviceState;
use ash::vk::{self, Handle};
use std::collections::HashMap;

/// A queue of the machine. Its handle is its address.
#[repr(C)]
struct Queue {
    /// The loader's table, which it puts here itself.
    table: usize,
    family: u32,
}

/// A submission that is held back.
struct Held {
    waits: Vec<vk::SemaphoreSubmitInfo<'static>>,
    commands: Vec<vk::CommandBufferSubmitInfo<'static>>,
    signals: Vec<vk::SemaphoreSubmitInfo<'static>>,
    fence: vk::Fence,
}

/// The driver's queue, those of the machine, and what is held back of them, oldest first.
pub(crate) struct Submissions {
    queue: vk::Queue,
    /// By family and index. The boxes give each its address.
    queues: HashMap<(u32, u32), Box<Queue>>,
    held: Vec<Held>,
}

impl Submissions {
    pub fn new(queue: vk::Queue) -> Self {
        Self { queue, queues: HashMap::new(), held: Vec::new() }
    }

    /// Submits what is held back.
    fn release(&mut self, state: &DeviceState) -> Result<(), vk::Result> {
        for held in self.held.drain(..) {
            let info = [vk::SubmitInfo2::default()
                .wait_semaphore_infos(&held.waits)
                .command_buffer_infos(&held.commands)
                .signal_semaphore_infos(&held.signals)];
            // SAFETY: a submission of the program's, whose objects live until it is done; the lock gives the queue to this
            // thread.
            let result = unsafe { (state.v13.queue_submit2)(self.queue, 1, info.as_ptr(), held.fence) };
            result.result()?;
        }
        Ok(())
    }

    fn signals(&self, semaphore: vk::Semaphore) -> bool {
        self.held.iter().flat_map(|held| &held.signals).any(|signal| signal.semaphore == semaphore)
    }
}

// SAFETY: the handles and addresses in it are used with its lock held only; no chain of structs is kept.
unsafe impl Send for Submissions {}

impl DeviceState {
    /// Submits what is held back.
    pub fn release_held(&self) {
        let _ = self.submissions().release(self);
    }
}

fn family_of(queue: vk::Queue) -> u32 {
    // SAFETY: the handles of queues that this layer gives out are addresses of its own objects, which live as the device does.
    unsafe { (*(queue.as_raw() as usize as *const Queue)).family }
}

pub(crate) unsafe extern "system" fn get(device: vk::Device, family: u32, index: u32, queue: *mut vk::Queue) {
    let state = DeviceState::of(device);
    let mut submissions = state.submissions();
    // SAFETY: a device begins with the loader's table, which its queues share.
    let table = unsafe { *(device.as_raw() as usize as *const usize) };
    let found =
        submissions.queues.entry((family, index)).or_insert_with(|| Box::new(Queue { table, family }));
    // SAFETY: the caller's place for a handle.
    unsafe { *queue = vk::Queue::from_raw((&raw mut **found) as usize as u64) }
}

pub(crate) unsafe extern "system" fn get2(
    device: vk::Device,
    info: *const vk::DeviceQueueInfo2<'_>,
    queue: *mut vk::Queue,
) {
    // SAFETY: the caller's arguments.
    unsafe { get(device, (*info).queue_family_index, (*info).queue_index, queue) }
}

pub(crate) unsafe extern "system" fn submit(
    queue: vk::Queue,
    count: u32,
    submits: *const vk::SubmitInfo<'_>,
    fence: vk::Fence,
) -> vk::Result {
    let state = DeviceState::of(queue);
    let mut submissions = state.submissions();
    if let Err(error) = submissions.release(&state) {
        return error;
    }
    // SAFETY: the caller's arguments; the lock gives the driver's queue to this thread.
    unsafe { (state.v10.queue_submit)(submissions.queue, count, submits, fence) }
}

/// Copies of the lists of a submission, which do not point to anything.
fn copies(info: &vk::SubmitInfo2<'_>) -> Held {
    // SAFETY: the caller's arrays have these lengths.
    let (waits, commands, signals) = unsafe {
        (
            list(info.p_wait_semaphore_infos, info.wait_semaphore_info_count),
            list(info.p_command_buffer_infos, info.command_buffer_info_count),
            list(info.p_signal_semaphore_infos, info.signal_semaphore_info_count),
        )
    };
    let semaphore = |from: &vk::SemaphoreSubmitInfo<'_>| {
        vk::SemaphoreSubmitInfo::default()
            .semaphore(from.semaphore)
            .value(from.value)
            .stage_mask(from.stage_mask)
    };
    let buffer = |from: &vk::CommandBufferSubmitInfo<'_>| {
        vk::CommandBufferSubmitInfo::default().command_buffer(from.command_buffer)
    };
    Held {
        waits: waits.iter().map(semaphore).collect(),
        commands: commands.iter().map(buffer).collect(),
        signals: signals.iter().map(semaphore).collect(),
        fence: vk::Fence::null(),
    }
}

/// A slice of a caller's.
unsafe fn list<'a, T>(pointer: *const T, count: u32) -> &'a [T] {
    // SAFETY: the caller's array has as many elements; without any the address may be null.
    if count == 0 { &[] } else { unsafe { std::slice::from_raw_parts(pointer, count as usize) } }
}

pub(crate) unsafe extern "system" fn submit2(
    queue: vk::Queue,
    count: u32,
    submits: *const vk::SubmitInfo2<'_>,
    fence: vk::Fence,
) -> vk::Result {
    let state = DeviceState::of(queue);
    let mut submissions = state.submissions();
    // SAFETY: the caller's arguments; the lock gives the driver's queue to this thread.
    unsafe {
        let infos = list(submits, count);
        if count > 0 && state.machine.holds(family_of(queue)) {
            submissions.held.extend(infos.iter().map(copies));
            if let Some(last) = submissions.held.last_mut() {
                last.fence = fence;
            }
            return vk::Result::SUCCESS;
        }
        let mut waited =
            infos.iter().flat_map(|info| list(info.p_wait_semaphore_infos, info.wait_semaphore_info_count));
        if waited.any(|wait| submissions.signals(wait.semaphore))
            && let Err(error) = submissions.release(&state)
        {
            return error;
        }
        (state.v13.queue_submit2)(submissions.queue, count, submits, fence)
    }
}

pub(crate) unsafe extern "system" fn wait_idle(queue: vk::Queue) -> vk::Result {
    let state = DeviceState::of(queue);
    let mut submissions = state.submissions();
    if let Err(error) = submissions.release(&state) {
        return error;
    }
    // SAFETY: the lock gives the driver's queue to this thread.
    unsafe { (state.v10.queue_wait_idle)(submissions.queue) }
}

pub(crate) unsafe extern "system" fn device_wait_idle(device: vk::Device) -> vk::Result {
    let state = DeviceState::of(device);
    let mut submissions = state.submissions();
    if let Err(error) = submissions.release(&state) {
        return error;
    }
    // SAFETY: as above: the driver's one queue stands for all.
    unsafe { (state.v10.device_wait_idle)(device) }
}

pub(crate) unsafe extern "system" fn present(
    queue: vk::Queue,
    info: *const vk::PresentInfoKHR<'_>,
) -> vk::Result {
    let state = DeviceState::of(queue);
    let mut submissions = state.submissions();
    let _ = submissions.release(&state);
    // SAFETY: as above.
    unsafe { (state.swapchain.queue_present_khr)(submissions.queue, info) }
}

pub(crate) unsafe extern "system" fn wait_for_fences(
    device: vk::Device,
    count: u32,
    fences: *const vk::Fence,
    all: vk::Bool32,
    timeout: u64,
) -> vk::Result {
    let state = DeviceState::of(device);
    state.release_held();
    // SAFETY: the caller's arguments.
    unsafe { (state.v10.wait_for_fences)(device, count, fences, all, timeout) }
}

pub(crate) unsafe extern "system" fn fence_status(device: vk::Device, fence: vk::Fence) -> vk::Result {
    let state = DeviceState::of(device);
    state.release_held();
    // SAFETY: as above.
    unsafe { (state.v10.get_fence_status)(device, fence) }
}

pub(crate) unsafe extern "system" fn wait_semaphores(
    device: vk::Device,
    info: *const vk::SemaphoreWaitInfo<'_>,
    timeout: u64,
) -> vk::Result {
    let state = DeviceState::of(device);
    state.release_held();
    // SAFETY: as above.
    unsafe { (state.v12.wait_semaphores)(device, info, timeout) }
}

pub(crate) unsafe extern "system" fn semaphore_value(
    device: vk::Device,
    semaphore: vk::Semaphore,
    value: *mut u64,
) -> vk::Result {
    let state = DeviceState::of(device);
    state.release_held();
    // SAFETY: as above.
    unsafe { (state.v12.get_semaphore_counter_value)(device, semaphore, value) }
}

pub(crate) unsafe extern "system" fn event_status(device: vk::Device, event: vk::Event) -> vk::Result {
    let state = DeviceState::of(device);
    state.release_held();
    // SAFETY: as above.
    unsafe { (state.v10.get_event_status)(device, event) }
}

pub(crate) unsafe extern "system" fn begin_label(queue: vk::Queue, label: *const vk::DebugUtilsLabelEXT<'_>) {
    let state = DeviceState::of(queue);
    let submissions = state.submissions();
    // SAFETY: as above.
    unsafe { (state.debug.queue_begin_debug_utils_label_ext)(submissions.queue, label) }
}

pub(crate) unsafe extern "system" fn insert_label(
    queue: vk::Queue,
    label: *const vk::DebugUtilsLabelEXT<'_>,
) {
    let state = DeviceState::of(queue);
    let submissions = state.submissions();
    // SAFETY: as above.
    unsafe { (state.debug.queue_insert_debug_utils_label_ext)(submissions.queue, label) }
}

pub(crate) unsafe extern "system" fn end_label(queue: vk::Queue) {
    let state = DeviceState::of(queue);
    let submissions = state.submissions();
    // SAFETY: as above.
    unsafe { (state.debug.queue_end_debug_utils_label_ext)(submissions.queue) }
}

/// Names of the machine's queues end here: the driver has but one.
pub(crate) unsafe extern "system" fn name_object(
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
