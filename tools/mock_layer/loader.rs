//! The interface between loader and layer (vk_layer.h), and the tables of functions.

use super::state::{Callbacks, DEVICES, DeviceState, INSTANCES, InstanceState, SetLoaderData};
use super::submissions::Wait;
use super::{answers, commands, memory, queues};
use ash::vk;
use std::ffi::{CStr, c_char, c_void};
use std::ptr::null_mut;

/// VkNegotiateLayerInterface.
#[repr(C)]
pub struct Negotiation {
    kind: u32,
    next: *mut c_void,
    version: u32,
    get_instance_proc_addr: Option<vk::PFN_vkGetInstanceProcAddr>,
    get_device_proc_addr: Option<vk::PFN_vkGetDeviceProcAddr>,
    get_physical_device_proc_addr: Option<vk::PFN_vkGetInstanceProcAddr>,
}

/// VkLayerInstanceLink and VkLayerDeviceLink; only the latter has the device's function.
#[repr(C)]
struct Link {
    next: *mut Link,
    get_instance_proc_addr: vk::PFN_vkGetInstanceProcAddr,
    get_device_proc_addr: Option<vk::PFN_vkGetDeviceProcAddr>,
}

/// VkLayerInstanceCreateInfo and VkLayerDeviceCreateInfo.
#[repr(C)]
struct LayerInfo {
    kind: vk::StructureType,
    next: *const c_void,
    function: i32,
    /// A link for [`LINK`], a function for [`DATA`].
    content: *mut c_void,
}

const LINK: i32 = 0;
const DATA: i32 = 1;

/// Finds the loader's struct of a kind and function in a chain.
unsafe fn find(mut chain: *const c_void, kind: vk::StructureType, function: i32) -> *mut LayerInfo {
    while !chain.is_null() {
        let info = chain.cast_mut().cast::<LayerInfo>();
        // SAFETY: every struct of a chain begins with its kind and the next one; the rest is read only of the loader's kind.
        unsafe {
            if (*info).kind == kind && (*info).function == function {
                return info;
            }
            chain = (*info).next;
        }
    }
    null_mut()
}

/// Returns the next layer's functions and advances the chain to it.
unsafe fn take_link(
    chain: *const c_void,
    kind: vk::StructureType,
) -> Option<(vk::PFN_vkGetInstanceProcAddr, Option<vk::PFN_vkGetDeviceProcAddr>)> {
    // SAFETY: the loader's chain, whose link is this layer's alone during the call.
    unsafe {
        let info = find(chain, kind, LINK);
        let link = info.as_ref()?.content.cast::<Link>();
        let found = ((*link).get_instance_proc_addr, (*link).get_device_proc_addr);
        (*info).content = (*link).next.cast();
        Some(found)
    }
}

/// Negotiates the interface version with the loader.
#[unsafe(no_mangle)]
pub unsafe extern "system" fn vkNegotiateLoaderLayerInterfaceVersion(
    negotiation: *mut Negotiation,
) -> vk::Result {
    // SAFETY: the loader's struct, valid during the call.
    let negotiation = unsafe { &mut *negotiation };
    if negotiation.version < 2 {
        return vk::Result::ERROR_INITIALIZATION_FAILED;
    }
    negotiation.version = 2;
    negotiation.get_instance_proc_addr = Some(get_instance_proc_addr);
    negotiation.get_device_proc_addr = Some(get_device_proc_addr);
    negotiation.get_physical_device_proc_addr = None;
    vk::Result::SUCCESS
}

unsafe extern "system" fn create_instance(
    info: *const vk::InstanceCreateInfo<'_>,
    callbacks: Callbacks<'_>,
    instance: *mut vk::Instance,
) -> vk::Result {
    // SAFETY: the loader's arguments; what they point to is valid during the call, and so are the next layer's functions.
    let created = || unsafe {
        let (next, _) = take_link((*info).p_next, vk::StructureType::LOADER_INSTANCE_CREATE_INFO)?;
        let create = next(vk::Instance::null(), c"vkCreateInstance".as_ptr())?;
        let create: vk::PFN_vkCreateInstance = std::mem::transmute(create);
        let result = create(info, callbacks, instance);
        if result == vk::Result::SUCCESS {
            InstanceState::add(*instance, next);
        }
        Some(result)
    };
    created().unwrap_or(vk::Result::ERROR_INITIALIZATION_FAILED)
}

unsafe extern "system" fn destroy_instance(instance: vk::Instance, callbacks: Callbacks<'_>) {
    if instance != vk::Instance::null()
        && let Some(state) = INSTANCES.remove(instance)
    {
        // SAFETY: the caller's arguments.
        unsafe { (state.functions.destroy_instance)(instance, callbacks) }
    }
}

unsafe extern "system" fn create_device(
    physical: vk::PhysicalDevice,
    info: *const vk::DeviceCreateInfo<'_>,
    callbacks: Callbacks<'_>,
    device: *mut vk::Device,
) -> vk::Result {
    let instance = InstanceState::of(physical);
    let kind = vk::StructureType::LOADER_DEVICE_CREATE_INFO;
    // SAFETY: the loader's arguments; what they point to is valid during the call, and so are the next layer's functions.
    let created = || unsafe {
        let data = find((*info).p_next, kind, DATA);
        let (next, next_of_device) = take_link((*info).p_next, kind)?;
        let next_of_device = next_of_device?;
        let create = next(instance.instance, c"vkCreateDevice".as_ptr())?;
        let create: vk::PFN_vkCreateDevice = std::mem::transmute(create);
        let set: Option<SetLoaderData> = data.as_ref().map(|data| std::mem::transmute(data.content));
        // One queue of the driver serves all queues of the machine.
        let priorities = [1.0];
        let queue = [vk::DeviceQueueCreateInfo::default().queue_priorities(&priorities)];
        let extensions = answers::driver_extensions(&instance, physical, &*info);
        let own = (*info).queue_create_infos(&queue).enabled_extension_names(&extensions);
        let result = create(physical, &raw const own, callbacks, device);
        if result == vk::Result::SUCCESS {
            DeviceState::add(*device, physical, &instance, next_of_device, set);
        }
        Some(result)
    };
    created().unwrap_or(vk::Result::ERROR_INITIALIZATION_FAILED)
}

unsafe extern "system" fn destroy_device(device: vk::Device, callbacks: Callbacks<'_>) {
    if device != vk::Device::null()
        && let Some(state) = DEVICES.remove(device)
    {
        state.start_needed_by(Wait::All);
        // SAFETY: the caller's arguments.
        unsafe { (state.v10.destroy_device)(device, callbacks) }
    }
}

/// Searches a list of `PFN_name => function;`. A name may have the ending of the extension from which the function came.
macro_rules! functions {
    ($requested:expr; $($kind:ident => $function:expr;)*) => {{
        let requested = $requested.to_str().unwrap_or_default();
        $(
            let name = stringify!($kind).trim_start_matches("PFN_");
            if requested == name || requested.strip_suffix("KHR") == Some(name) {
                let function: vk::$kind = $function;
                // SAFETY: a function pointer becomes another; the caller casts it back, according to the name.
                return Some(unsafe { std::mem::transmute::<vk::$kind, unsafe extern "system" fn()>(function) });
            }
        )*
        None
    }};
}

fn of_instance(name: &CStr) -> vk::PFN_vkVoidFunction {
    functions! { name;
        PFN_vkGetInstanceProcAddr => get_instance_proc_addr;
        PFN_vkCreateInstance => create_instance;
        PFN_vkDestroyInstance => destroy_instance;
        PFN_vkCreateDevice => create_device;
        PFN_vkEnumerateDeviceExtensionProperties => answers::extensions;
        PFN_vkGetPhysicalDeviceProperties => answers::properties;
        PFN_vkGetPhysicalDeviceProperties2 => answers::properties2;
        PFN_vkGetPhysicalDeviceMemoryProperties => answers::memory;
        PFN_vkGetPhysicalDeviceMemoryProperties2 => answers::memory2;
        PFN_vkGetPhysicalDeviceQueueFamilyProperties => answers::families;
        PFN_vkGetPhysicalDeviceQueueFamilyProperties2 => answers::families2;
        PFN_vkGetPhysicalDeviceSurfaceSupportKHR => answers::surface_support;
    }
}

fn of_device(name: &CStr) -> vk::PFN_vkVoidFunction {
    functions! { name;
        PFN_vkGetDeviceProcAddr => get_device_proc_addr;
        PFN_vkDestroyDevice => destroy_device;
        PFN_vkAllocateMemory => memory::allocate;
        PFN_vkFreeMemory => memory::free;
        PFN_vkMapMemory => memory::map;
        PFN_vkGetBufferMemoryRequirements => memory::of_buffer;
        PFN_vkGetBufferMemoryRequirements2 => memory::of_buffer2;
        PFN_vkGetImageMemoryRequirements => memory::of_image;
        PFN_vkGetImageMemoryRequirements2 => memory::of_image2;
        PFN_vkGetDeviceBufferMemoryRequirements => memory::of_new_buffer;
        PFN_vkGetDeviceImageMemoryRequirements => memory::of_new_image;
        PFN_vkCreateBuffer => memory::create_buffer;
        PFN_vkCreateImage => memory::create_image;
        PFN_vkCreateCommandPool => queues::create_command_pool;
        PFN_vkCmdPipelineBarrier => commands::barrier;
        PFN_vkCmdPipelineBarrier2 => commands::barrier2;
        PFN_vkCreateShaderModule => commands::create_shader_module;
        PFN_vkCreateComputePipelines => commands::create_compute_pipelines;
        PFN_vkBeginCommandBuffer => commands::begin;
        PFN_vkEndCommandBuffer => commands::end;
        PFN_vkCmdBindPipeline => commands::bind_pipeline;
        PFN_vkCmdPushConstants => commands::push_constants;
        PFN_vkCmdDispatch => commands::dispatch;
        PFN_vkCmdDispatchIndirect => commands::dispatch_indirect;
        PFN_vkCmdCopyBuffer => commands::copy_buffer;
        PFN_vkCmdFillBuffer => commands::fill_buffer;
        PFN_vkCmdUpdateBuffer => commands::update_buffer;
        PFN_vkGetDeviceQueue => queues::get;
        PFN_vkGetDeviceQueue2 => queues::get2;
        PFN_vkQueueSubmit => queues::submit;
        PFN_vkQueueSubmit2 => queues::submit2;
        PFN_vkQueueWaitIdle => queues::wait_idle;
        PFN_vkDeviceWaitIdle => queues::device_wait_idle;
        PFN_vkQueuePresentKHR => queues::present;
        PFN_vkWaitForFences => queues::wait_for_fences;
        PFN_vkGetFenceStatus => queues::fence_status;
        PFN_vkWaitSemaphores => queues::wait_semaphores;
        PFN_vkGetSemaphoreCounterValue => queues::semaphore_value;
        PFN_vkCreateSemaphore => queues::create_semaphore;
        PFN_vkDestroySemaphore => queues::destroy_semaphore;
        PFN_vkSignalSemaphore => queues::signal_semaphore;
        PFN_vkGetEventStatus => queues::event_status;
        PFN_vkQueueBeginDebugUtilsLabelEXT => queues::begin_label;
        PFN_vkQueueInsertDebugUtilsLabelEXT => queues::insert_label;
        PFN_vkQueueEndDebugUtilsLabelEXT => queues::end_label;
        PFN_vkSetDebugUtilsObjectNameEXT => queues::name_object;
    }
}

unsafe extern "system" fn get_instance_proc_addr(
    instance: vk::Instance,
    name: *const c_char,
) -> vk::PFN_vkVoidFunction {
    // SAFETY: the caller's name is a C string.
    let requested = unsafe { CStr::from_ptr(name) };
    let own = of_instance(requested).or_else(|| of_device(requested));
    if instance == vk::Instance::null() {
        return own;
    }
    // SAFETY: the caller's arguments, passed on.
    let next = unsafe { (InstanceState::of(instance).next)(instance, name) };
    // A function that no lower layer knows does not exist.
    next.and(own.or(next))
}

unsafe extern "system" fn get_device_proc_addr(
    device: vk::Device,
    name: *const c_char,
) -> vk::PFN_vkVoidFunction {
    // SAFETY: the caller's name is a C string; the arguments are passed on.
    let (requested, next) = unsafe { (CStr::from_ptr(name), (DeviceState::of(device).next)(device, name)) };
    next.and(of_device(requested).or(next))
}
