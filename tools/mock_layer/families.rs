//! Queue families: calls that name a family of the machine name the driver's only one instead.

use super::loader::{Callbacks, slice};
use super::state::DeviceState;
use ash::vk;

/// Exclusive to one family at a time: the driver has only one.
pub fn exclusive_buffer<'a>(info: &vk::BufferCreateInfo<'a>) -> vk::BufferCreateInfo<'a> {
    info.sharing_mode(vk::SharingMode::EXCLUSIVE).queue_family_indices(&[])
}

pub fn exclusive_image<'a>(info: &vk::ImageCreateInfo<'a>) -> vk::ImageCreateInfo<'a> {
    info.sharing_mode(vk::SharingMode::EXCLUSIVE).queue_family_indices(&[])
}

fn driver_family<'a>(info: &vk::CommandPoolCreateInfo<'a>) -> vk::CommandPoolCreateInfo<'a> {
    info.queue_family_index(0)
}

/// Defines functions that create an object from a changed description.
macro_rules! creations {
    ($($name:ident($info:ident) -> $object:ident, $changed:ident;)*) => {$(
        pub unsafe extern "system" fn $name(
            device: vk::Device,
            info: *const vk::$info<'_>,
            callbacks: Callbacks<'_>,
            object: *mut vk::$object,
        ) -> vk::Result {
            // SAFETY: the caller's arguments, passed on with another description.
            unsafe {
                let own = $changed(&*info);
                (DeviceState::of(device).v10.$name)(device, &raw const own, callbacks, object)
            }
        }
    )*};
}

creations! {
    create_buffer(BufferCreateInfo) -> Buffer, exclusive_buffer;
    create_image(ImageCreateInfo) -> Image, exclusive_image;
    create_command_pool(CommandPoolCreateInfo) -> CommandPool, driver_family;
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

/// Copies barriers with the driver's families.
macro_rules! remapped {
    ($barriers:expr, $count:expr) => {{
        let barriers = slice($barriers, $count).iter().map(|barrier| {
            let (from, to) = mapped(barrier.src_queue_family_index, barrier.dst_queue_family_index);
            barrier.src_queue_family_index(from).dst_queue_family_index(to)
        });
        barriers.collect::<Vec<_>>()
    }};
}

pub unsafe extern "system" fn barrier(
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
        let (buffers, images) = (remapped!(buffers, buffer_count), remapped!(images, image_count));
        let (b, i) = (buffers.as_ptr(), images.as_ptr());
        let next = DeviceState::of(commands).v10.cmd_pipeline_barrier;
        next(commands, before, after, flags, memory_count, memory, buffer_count, b, image_count, i);
    }
}

pub unsafe extern "system" fn barrier2(
    commands: vk::CommandBuffer,
    dependency: *const vk::DependencyInfo<'_>,
) {
    // SAFETY: as above.
    unsafe {
        let info = &*dependency;
        super::trace::barrier(commands, info);
        let buffers = remapped!(info.p_buffer_memory_barriers, info.buffer_memory_barrier_count);
        let images = remapped!(info.p_image_memory_barriers, info.image_memory_barrier_count);
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
