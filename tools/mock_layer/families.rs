//! Queue families: calls that name a family of the machine name the driver's only one instead.

use super::state::DeviceState;
use ash::vk;

/// Exclusive to one family at a time: the driver has only one.
pub(crate) fn exclusive_buffer<'a>(info: &vk::BufferCreateInfo<'a>) -> vk::BufferCreateInfo<'a> {
    info.sharing_mode(vk::SharingMode::EXCLUSIVE).queue_family_indices(&[])
}

pub(crate) fn exclusive_image<'a>(info: &vk::ImageCreateInfo<'a>) -> vk::ImageCreateInfo<'a> {
    info.sharing_mode(vk::SharingMode::EXCLUSIVE).queue_family_indices(&[])
}

pub(crate) unsafe extern "system" fn create_buffer(
    device: vk::Device,
    info: *const vk::BufferCreateInfo<'_>,
    callbacks: *const vk::AllocationCallbacks<'_>,
    buffer: *mut vk::Buffer,
) -> vk::Result {
    // SAFETY: the caller's arguments, passed on with another sharing mode.
    unsafe {
        let own = exclusive_buffer(&*info);
        (DeviceState::of(device).v10.create_buffer)(device, &raw const own, callbacks, buffer)
    }
}

pub(crate) unsafe extern "system" fn create_image(
    device: vk::Device,
    info: *const vk::ImageCreateInfo<'_>,
    callbacks: *const vk::AllocationCallbacks<'_>,
    image: *mut vk::Image,
) -> vk::Result {
    // SAFETY: as above.
    unsafe {
        let own = exclusive_image(&*info);
        (DeviceState::of(device).v10.create_image)(device, &raw const own, callbacks, image)
    }
}

pub(crate) unsafe extern "system" fn create_command_pool(
    device: vk::Device,
    info: *const vk::CommandPoolCreateInfo<'_>,
    callbacks: *const vk::AllocationCallbacks<'_>,
    pool: *mut vk::CommandPool,
) -> vk::Result {
    // SAFETY: as above, with the driver's family.
    unsafe {
        let own = (*info).queue_family_index(0);
        (DeviceState::of(device).v10.create_command_pool)(device, &raw const own, callbacks, pool)
    }
}

/// No transfer between families of the machine; a transfer from or to foreign families stays.
fn mapped(from: u32, to: u32) -> (u32, u32) {
    let outside = |family| family >= vk::QUEUE_FAMILY_FOREIGN_EXT;
    if from == to || !(outside(from) || outside(to)) {
        return (vk::QUEUE_FAMILY_IGNORED, vk::QUEUE_FAMILY_IGNORED);
    }
    let real = |family| if outside(family) { family } else { 0 };
    (real(from), real(to))
}

macro_rules! remapped {
    ($barriers:expr) => {
        $barriers.map(|barrier| {
            let (from, to) = mapped(barrier.src_queue_family_index, barrier.dst_queue_family_index);
            barrier.src_queue_family_index(from).dst_queue_family_index(to)
        })
    };
}

pub(crate) unsafe fn slice<'a, T>(pointer: *const T, count: u32) -> &'a [T] {
    // SAFETY: the caller's array has `count` elements; if there are none, the pointer may be null.
    if count == 0 { &[] } else { unsafe { std::slice::from_raw_parts(pointer, count as usize) } }
}

pub(crate) unsafe extern "system" fn barrier(
    commands: vk::CommandBuffer,
    before: vk::PipelineStageFlags,
    after: vk::PipelineStageFlags,
    flags: vk::DependencyFlags,
    memory_count: u32,
    memory: *const vk::MemoryBarrier<'_>,
    buffer_count: u32,
    buffers: *const vk::BufferMemoryBarrier<'_>,
    image_count: u32,
    images: *const vk::ImageMemoryBarrier<'_>,
) {
    // SAFETY: the caller's arguments, passed on with other families.
    unsafe {
        let buffers: Vec<_> = remapped!(slice(buffers, buffer_count).iter().copied()).collect();
        let images: Vec<_> = remapped!(slice(images, image_count).iter().copied()).collect();
        let (b, i) = (buffers.as_ptr(), images.as_ptr());
        let next = DeviceState::of(commands).v10.cmd_pipeline_barrier;
        next(commands, before, after, flags, memory_count, memory, buffer_count, b, image_count, i);
    }
}

pub(crate) unsafe extern "system" fn barrier2(
    commands: vk::CommandBuffer,
    dependency: *const vk::DependencyInfo<'_>,
) {
    // SAFETY: as above.
    unsafe {
        let info = &*dependency;
        super::trace::barrier(commands, info);
        let buffers = slice(info.p_buffer_memory_barriers, info.buffer_memory_barrier_count);
        let buffers: Vec<_> = remapped!(buffers.iter().copied()).collect();
        let images = slice(info.p_image_memory_barriers, info.image_memory_barrier_count);
        let images: Vec<_> = remapped!(images.iter().copied()).collect();
        let own = info.buffer_memory_barriers(&buffers).image_memory_barriers(&images);
        (DeviceState::of(commands).v13.cmd_pipeline_barrier2)(commands, &raw const own);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn families_of_the_machine_are_the_drivers_one() {
        let none = (vk::QUEUE_FAMILY_IGNORED, vk::QUEUE_FAMILY_IGNORED);
        assert_eq!(mapped(1, 2), none);
        assert_eq!(mapped(vk::QUEUE_FAMILY_IGNORED, vk::QUEUE_FAMILY_IGNORED), none);
        assert_eq!(mapped(2, vk::QUEUE_FAMILY_EXTERNAL), (0, vk::QUEUE_FAMILY_EXTERNAL));
        assert_eq!(mapped(vk::QUEUE_FAMILY_FOREIGN_EXT, 1), (vk::QUEUE_FAMILY_FOREIGN_EXT, 0));
    }
}
