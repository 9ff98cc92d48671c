//! Memory: the machine's types over the driver's first, limited heaps, mappings of host-visible memory, garbage in new memory; and
//! buffers and images, which the driver's one family owns.

use super::state::{Callbacks, DeviceState, heap_usage, passed_on};
use ash::vk::{self, Handle};
use std::ffi::c_void;
use std::ptr::null;

/// Every byte of new memory: NaN as a float, implausible as a count.
const GARBAGE: u8 = 0xFF;
/// Most bytes of an allocation that are filled.
const FILLED: u64 = 256 << 20;

pub unsafe extern "system" fn allocate(
    device: vk::Device,
    info: *const vk::MemoryAllocateInfo<'_>,
    callbacks: Callbacks<'_>,
    memory: *mut vk::DeviceMemory,
) -> vk::Result {
    let state = DeviceState::of(device);
    // SAFETY: the caller's arguments.
    let mut own = unsafe { *info };
    let kind = own.memory_type_index;
    let (_, heap) = state.machine.types[kind as usize];
    let (size, _) = state.machine.heaps[heap as usize];
    let bytes = own.allocation_size;
    if heap_usage(state.physical, heap).saturating_add(bytes) > size {
        return vk::Result::ERROR_OUT_OF_DEVICE_MEMORY;
    }
    own.memory_type_index = 0;
    // SAFETY: the caller's arguments, with a type that every driver has.
    let result = unsafe { (state.v10.allocate_memory)(device, &raw const own, callbacks, memory) };
    if result == vk::Result::SUCCESS {
        // SAFETY: written by the call.
        let memory = unsafe { *memory };
        state.memory().insert(memory.as_raw(), (kind, heap, bytes));
        fill(&state, memory, bytes.min(FILLED));
    }
    result
}

fn fill(state: &DeviceState, memory: vk::DeviceMemory, bytes: u64) {
    let mut address = std::ptr::null_mut::<c_void>();
    let flags = vk::MemoryMapFlags::empty();
    // SAFETY: new memory of the driver's first type, which is host-visible on this layer's drivers; otherwise the call fails.
    // It is mapped once, filled within its bounds and unmapped.
    unsafe {
        let result = (state.v10.map_memory)(state.device, memory, 0, bytes, flags, &raw mut address);
        if result == vk::Result::SUCCESS {
            std::ptr::write_bytes(address.cast::<u8>(), GARBAGE, bytes as usize);
            (state.v10.unmap_memory)(state.device, memory);
        }
    }
}

passed_on! {
    free(device: vk::Device, memory: vk::DeviceMemory, callbacks: Callbacks<'_>),
        v10.free_memory, |state| state.memory().remove(&memory.as_raw());
}

pub unsafe extern "system" fn map(
    device: vk::Device,
    memory: vk::DeviceMemory,
    offset: u64,
    size: u64,
    flags: vk::MemoryMapFlags,
    address: *mut *mut c_void,
) -> vk::Result {
    let state = DeviceState::of(device);
    let kind = state.memory().get(&memory.as_raw()).map(|(kind, ..)| *kind as usize);
    let seen =
        kind.is_some_and(|kind| state.machine.types[kind].0.contains(vk::MemoryPropertyFlags::HOST_VISIBLE));
    if !seen {
        return vk::Result::ERROR_MEMORY_MAP_FAILED;
    }
    // SAFETY: the caller's arguments.
    unsafe { (state.v10.map_memory)(device, memory, offset, size, flags, address) }
}

/// Allows every type of the machine if the driver allows its first.
fn allow(state: &DeviceState, requirements: &mut vk::MemoryRequirements) {
    requirements.memory_type_bits = (requirements.memory_type_bits & 1) * state.machine.type_bits();
}

/// Defines queries of memory requirements. A row has the function's name, the types of its input and output, the driver's
/// function, and the output's field with the requirements.
macro_rules! requirements {
    ($($name:ident($requested:ty) -> $written:ty, $version:ident.$next:ident, $($place:ident)?;)*) => {$(
        pub unsafe extern "system" fn $name(device: vk::Device, requested: $requested, written: *mut $written) {
            let state = DeviceState::of(device);
            // SAFETY: the caller's arguments; the struct is written by the call.
            unsafe {
                (state.$version.$next)(device, requested, written);
                allow(&state, &mut (*written)$(.$place)?);
            }
        }
    )*};
}

requirements! {
    of_buffer(vk::Buffer) -> vk::MemoryRequirements,
        v10.get_buffer_memory_requirements,;
    of_image(vk::Image) -> vk::MemoryRequirements,
        v10.get_image_memory_requirements,;
    of_buffer2(*const vk::BufferMemoryRequirementsInfo2<'_>) -> vk::MemoryRequirements2<'_>,
        v11.get_buffer_memory_requirements2, memory_requirements;
    of_image2(*const vk::ImageMemoryRequirementsInfo2<'_>) -> vk::MemoryRequirements2<'_>,
        v11.get_image_memory_requirements2, memory_requirements;
}

/// Makes a resource exclusive to one family, because the driver has only one.
macro_rules! exclusive {
    ($info:expr) => {
        $info.sharing_mode(vk::SharingMode::EXCLUSIVE).queue_family_indices(&[])
    };
}

/// Defines functions that create a resource, and queries about one that does not exist yet. A row has the names of both
/// functions, their descriptions, and the driver's functions.
macro_rules! resources {
    ($($create:ident($info:ident) -> $object:ident, $query:ident($requested:ident), $next:ident;)*) => {$(
        pub unsafe extern "system" fn $create(
            device: vk::Device,
            info: *const vk::$info<'_>,
            callbacks: Callbacks<'_>,
            object: *mut vk::$object,
        ) -> vk::Result {
            // SAFETY: the caller's arguments, passed on with another description.
            unsafe {
                let own = exclusive!(*info);
                (DeviceState::of(device).v10.$create)(device, &raw const own, callbacks, object)
            }
        }

        pub unsafe extern "system" fn $query(
            device: vk::Device,
            info: *const vk::$requested<'_>,
            requirements: *mut vk::MemoryRequirements2<'_>,
        ) {
            let state = DeviceState::of(device);
            // SAFETY: the caller's arguments; the changed description outlives the call.
            unsafe {
                let mut own = *info;
                let create = own.p_create_info.as_ref().map(|create| exclusive!(create));
                own.p_create_info = create.as_ref().map_or(null(), |create| create);
                (state.v13.$next)(device, &raw const own, requirements);
                allow(&state, &mut (*requirements).memory_requirements);
            }
        }
    )*};
}

resources! {
    create_buffer(BufferCreateInfo) -> Buffer,
        of_new_buffer(DeviceBufferMemoryRequirements), get_device_buffer_memory_requirements;
    create_image(ImageCreateInfo) -> Image,
        of_new_image(DeviceImageMemoryRequirements), get_device_image_memory_requirements;
}
