//! Semaphores: which are timelines, and the host's signals, waits and queries.

use super::held::Want;
use super::queues::list;
use super::state::DeviceState;
use ash::vk;

pub(crate) unsafe extern "system" fn create_semaphore(
    device: vk::Device,
    info: *const vk::SemaphoreCreateInfo<'_>,
    callbacks: *const vk::AllocationCallbacks<'_>,
    semaphore: *mut vk::Semaphore,
) -> vk::Result {
    let state = DeviceState::of(device);
    // SAFETY: the caller's arguments; every struct of a chain begins with its kind and the next pointer.
    unsafe {
        let result = (state.v10.create_semaphore)(device, info, callbacks, semaphore);
        let mut chain = (*info).p_next.cast::<vk::BaseInStructure<'_>>();
        while let Some(of) = chain.as_ref() {
            let kind = chain.cast::<vk::SemaphoreTypeCreateInfo<'_>>();
            if result == vk::Result::SUCCESS
                && of.s_type == vk::StructureType::SEMAPHORE_TYPE_CREATE_INFO
                && (*kind).semaphore_type == vk::SemaphoreType::TIMELINE
            {
                state.submissions().order.add_timeline(*semaphore, (*kind).initial_value);
            }
            chain = of.p_next;
        }
        result
    }
}

pub(crate) unsafe extern "system" fn destroy_semaphore(
    device: vk::Device,
    semaphore: vk::Semaphore,
    callbacks: *const vk::AllocationCallbacks<'_>,
) {
    let state = DeviceState::of(device);
    state.submissions().order.forget(semaphore);
    // SAFETY: the caller's arguments.
    unsafe { (state.v10.destroy_semaphore)(device, semaphore, callbacks) }
}

pub(crate) unsafe extern "system" fn signal_semaphore(
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
    submissions.order.signalled(point);
    submissions.go_on(&state)
}

pub(crate) unsafe extern "system" fn wait_semaphores(
    device: vk::Device,
    info: *const vk::SemaphoreWaitInfo<'_>,
    timeout: u64,
) -> vk::Result {
    let state = DeviceState::of(device);
    // SAFETY: the caller's arguments.
    let wants: Vec<_> = unsafe {
        let semaphores = list((*info).p_semaphores, (*info).semaphore_count).iter();
        let values = list((*info).p_values, (*info).semaphore_count).iter();
        semaphores.zip(values).map(|(&semaphore, &value)| Want::Point((semaphore, value))).collect()
    };
    // SAFETY: as above.
    state.wait(&wants, || unsafe { (state.v12.wait_semaphores)(device, info, timeout) })
}

pub(crate) unsafe extern "system" fn semaphore_value(
    device: vk::Device,
    semaphore: vk::Semaphore,
    value: *mut u64,
) -> vk::Result {
    let state = DeviceState::of(device);
    let reached = state.submissions().order.reached(semaphore);
    // Each query starts what the next value needs, so that a polling host makes progress.
    state.ask(Want::Point((semaphore, reached.unwrap_or_default() + 1)));
    // SAFETY: as above.
    unsafe { (state.v12.get_semaphore_counter_value)(device, semaphore, value) }
}
