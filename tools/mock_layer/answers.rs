//! Properties that the layer reports in the driver's place.

use super::machine::Machine;
use super::state::{InstanceState, heap_usage, in_chain, slice};
use ash::vk;
use std::ffi::{CStr, c_char};

/// Extensions with memory types or queues that the layer cannot translate.
const HIDDEN: [&CStr; 5] = [
    c"VK_EXT_external_memory_host",
    c"VK_KHR_external_memory_fd",
    c"VK_EXT_external_memory_dma_buf",
    c"VK_EXT_host_image_copy",
    c"VK_KHR_map_memory2",
];

pub unsafe extern "system" fn properties(
    physical: vk::PhysicalDevice,
    properties: *mut vk::PhysicalDeviceProperties,
) {
    let state = InstanceState::of(physical);
    // SAFETY: the caller's arguments; the struct is written by the call.
    unsafe {
        (state.functions.get_physical_device_properties)(physical, properties);
        state.machine.describe(&mut *properties);
    }
}

pub unsafe extern "system" fn properties2(
    physical: vk::PhysicalDevice,
    properties: *mut vk::PhysicalDeviceProperties2<'_>,
) {
    let state = InstanceState::of(physical);
    // SAFETY: as above.
    unsafe {
        (state.v11.get_physical_device_properties2)(physical, properties);
        state.machine.describe(&mut (*properties).properties);
        if state.machine.small {
            let push = in_chain::<vk::PhysicalDevicePushDescriptorPropertiesKHR<'_>>((*properties).p_next);
            if let Some(push) = push.as_mut() {
                push.max_push_descriptors = push.max_push_descriptors.min(32);
            }
        }
    }
}

fn write_memory(machine: &Machine, memory: &mut vk::PhysicalDeviceMemoryProperties) {
    *memory = vk::PhysicalDeviceMemoryProperties::default();
    (memory.memory_type_count, memory.memory_heap_count) =
        (machine.types.len() as u32, machine.heaps.len() as u32);
    for (to, &(property_flags, heap_index)) in memory.memory_types.iter_mut().zip(machine.types) {
        *to = vk::MemoryType { property_flags, heap_index };
    }
    for (to, &(size, local)) in memory.memory_heaps.iter_mut().zip(machine.heaps) {
        let flags = if local { vk::MemoryHeapFlags::DEVICE_LOCAL } else { vk::MemoryHeapFlags::empty() };
        *to = vk::MemoryHeap { size, flags };
    }
}

pub unsafe extern "system" fn memory(
    physical: vk::PhysicalDevice,
    memory: *mut vk::PhysicalDeviceMemoryProperties,
) {
    // SAFETY: the caller's struct.
    write_memory(InstanceState::of(physical).machine, unsafe { &mut *memory });
}

pub unsafe extern "system" fn memory2(
    physical: vk::PhysicalDevice,
    memory: *mut vk::PhysicalDeviceMemoryProperties2<'_>,
) {
    let state = InstanceState::of(physical);
    // SAFETY: the caller's structs.
    unsafe {
        (state.v11.get_physical_device_memory_properties2)(physical, memory);
        let properties = &mut (*memory).memory_properties;
        write_memory(state.machine, properties);
        let budget = in_chain::<vk::PhysicalDeviceMemoryBudgetPropertiesEXT<'_>>((*memory).p_next);
        let Some(budget) = budget.as_mut() else { return };
        for (heap, described) in properties.memory_heaps_as_slice().iter().enumerate() {
            // A desktop leaves about this much.
            budget.heap_budget[heap] = described.size / 16 * 15;
            budget.heap_usage[heap] = heap_usage(physical, heap as u32);
        }
    }
}

/// Queue families of the machine, with the timestamp clock of the driver's first family.
fn described(state: &InstanceState, physical: vk::PhysicalDevice) -> Vec<vk::QueueFamilyProperties> {
    let mut real = vk::QueueFamilyProperties::default();
    let mut one = 1;
    // SAFETY: a plain query, of one family.
    unsafe {
        (state.functions.get_physical_device_queue_family_properties)(physical, &raw mut one, &raw mut real);
    }
    let family = |&queue_flags: &vk::QueueFlags| vk::QueueFamilyProperties {
        queue_flags: queue_flags & (real.queue_flags | vk::QueueFlags::TRANSFER),
        queue_count: 1,
        ..real
    };
    state.machine.families.iter().map(family).collect()
}

/// Answers an enumeration: the number of elements without an array, otherwise as many elements as the array holds.
///
/// # Safety
/// `count` is the caller's counter, `array` null or an array of that many elements; `write` writes one.
unsafe fn enumerate<T, E: Copy>(
    all: &[E],
    count: *mut u32,
    array: *mut T,
    write: impl Fn(*mut T, E),
) -> vk::Result {
    // SAFETY: as promised.
    unsafe {
        if array.is_null() {
            *count = all.len() as u32;
            return vk::Result::SUCCESS;
        }
        let written = (*count as usize).min(all.len());
        all[..written].iter().enumerate().for_each(|(index, &element)| write(array.add(index), element));
        *count = written as u32;
        if written < all.len() { vk::Result::INCOMPLETE } else { vk::Result::SUCCESS }
    }
}

pub unsafe extern "system" fn families(
    physical: vk::PhysicalDevice,
    count: *mut u32,
    families: *mut vk::QueueFamilyProperties,
) {
    let described = described(&InstanceState::of(physical), physical);
    // SAFETY: the caller's counter and array.
    let _ = unsafe { enumerate(&described, count, families, |to, family| *to = family) };
}

pub unsafe extern "system" fn families2(
    physical: vk::PhysicalDevice,
    count: *mut u32,
    families: *mut vk::QueueFamilyProperties2<'_>,
) {
    let described = described(&InstanceState::of(physical), physical);
    // SAFETY: as above. Chained structs stay unchanged.
    let _ = unsafe {
        enumerate(&described, count, families, |to, family| (*to).queue_family_properties = family)
    };
}

pub unsafe extern "system" fn surface_support(
    physical: vk::PhysicalDevice,
    family: u32,
    surface: vk::SurfaceKHR,
    supported: *mut vk::Bool32,
) -> vk::Result {
    let state = InstanceState::of(physical);
    let draws = state.machine.families.get(family as usize);
    // SAFETY: the caller's arguments, with the driver's family.
    unsafe {
        let next = state.surface.get_physical_device_surface_support_khr;
        let result = next(physical, 0, surface, supported);
        if !draws.is_some_and(|flags| flags.contains(vk::QueueFlags::GRAPHICS)) {
            *supported = vk::FALSE;
        }
        result
    }
}

/// Device extensions of the driver.
fn of_driver(state: &InstanceState, physical: vk::PhysicalDevice) -> Vec<vk::ExtensionProperties> {
    let next = state.functions.enumerate_device_extension_properties;
    let mut count = 0;
    // SAFETY: two plain queries; the second's array has the counted size.
    unsafe {
        let _ = next(physical, std::ptr::null(), &raw mut count, std::ptr::null_mut());
        let mut all = vec![vk::ExtensionProperties::default(); count as usize];
        let _ = next(physical, std::ptr::null(), &raw mut count, all.as_mut_ptr());
        all.truncate(count as usize);
        all
    }
}

fn has(extensions: &[vk::ExtensionProperties], name: &CStr) -> bool {
    extensions.iter().any(|extension| extension.extension_name_as_c_str() == Ok(name))
}

/// Adds the memory budget, which the layer answers itself, and hides extensions that it does not know.
pub unsafe extern "system" fn extensions(
    physical: vk::PhysicalDevice,
    layer: *const c_char,
    count: *mut u32,
    extensions: *mut vk::ExtensionProperties,
) -> vk::Result {
    let state = InstanceState::of(physical);
    if !layer.is_null() {
        // SAFETY: the caller's arguments.
        return unsafe {
            (state.functions.enumerate_device_extension_properties)(physical, layer, count, extensions)
        };
    }
    let mut all = of_driver(&state, physical);
    all.retain(|extension| !extension.extension_name_as_c_str().is_ok_and(|name| HIDDEN.contains(&name)));
    let budget = ash::ext::memory_budget::NAME;
    if !has(&all, budget) {
        let mut added = vk::ExtensionProperties { spec_version: 1, ..Default::default() };
        for (to, from) in added.extension_name.iter_mut().zip(budget.to_bytes()) {
            *to = *from as c_char;
        }
        all.push(added);
    }
    // SAFETY: the caller's counter and array.
    unsafe { enumerate(&all, count, extensions, |to, extension| *to = extension) }
}

/// Extensions that a program enables, without those that the layer adds.
///
/// # Safety
/// `info` is a valid description of a device.
pub unsafe fn driver_extensions(
    state: &InstanceState,
    physical: vk::PhysicalDevice,
    info: &vk::DeviceCreateInfo<'_>,
) -> Vec<*const c_char> {
    let present = of_driver(state, physical);
    // SAFETY: as promised: an array of C strings of this length.
    unsafe {
        let names = slice(info.pp_enabled_extension_names, info.enabled_extension_count);
        let budget = ash::ext::memory_budget::NAME;
        let kept = |name: &&*const c_char| CStr::from_ptr(**name) != budget || has(&present, budget);
        names.iter().filter(kept).copied().collect()
    }
}
