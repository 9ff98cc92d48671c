//! A device that compiles kernels and runs nothing, for compiler statistics ([`Context::pipeline_statistics`]).
//!
//! Its function table has the driver's functions for shaders, layouts and pipelines, and this file's for all others. Memory
//! is host memory that begins as zeros, commands are dropped, and submissions finish at once. So a run takes its usual path
//! on drivers that have a compiler and no device, such as Mesa with RADV_FORCE_FAMILY.
//!
//! [`Context::pipeline_statistics`]: super::Context::pipeline_statistics

use ash::vk::{self, Handle};
use std::alloc::{Layout, alloc_zeroed, dealloc};
use std::ffi::{CStr, c_char, c_void};
use std::sync::atomic::{AtomicU64, Ordering};

/// Reported size of device memory. The driver may have none.
const HEAP_BYTES: u64 = 1 << 40;
/// Alignment of all memory and buffers.
const ALIGNMENT: u64 = 256;
/// Alignment of the host memory. Up to this alignment the system provides zeros without writing them.
const HOST_ALIGNMENT: usize = 16;

/// Returns one heap with one host-visible memory type.
pub(super) fn memory_properties() -> vk::PhysicalDeviceMemoryProperties {
    let mut memory = vk::PhysicalDeviceMemoryProperties {
        memory_type_count: 1,
        memory_heap_count: 1,
        ..vk::PhysicalDeviceMemoryProperties::default()
    };
    memory.memory_types[0].property_flags = vk::MemoryPropertyFlags::DEVICE_LOCAL
        | vk::MemoryPropertyFlags::HOST_VISIBLE
        | vk::MemoryPropertyFlags::HOST_COHERENT;
    memory.memory_heaps[0] = vk::MemoryHeap { size: HEAP_BYTES, flags: vk::MemoryHeapFlags::DEVICE_LOCAL };
    memory
}

/// Functions taken from the driver. All others are of this file, or absent: calling an absent one ends the program.
const OF_THE_DRIVER: [&CStr; 12] = [
    c"vkCreateComputePipelines",
    c"vkCreateDescriptorSetLayout",
    c"vkCreatePipelineCache",
    c"vkCreatePipelineLayout",
    c"vkCreateShaderModule",
    c"vkDestroyDescriptorSetLayout",
    c"vkDestroyDevice",
    c"vkDestroyPipeline",
    c"vkDestroyPipelineCache",
    c"vkDestroyPipelineLayout",
    c"vkDestroyShaderModule",
    c"vkGetDeviceQueue",
];

/// Returns the device with this function table.
///
/// # Safety
/// The device is of this instance.
pub(super) unsafe fn table(instance: &ash::Instance, device: &ash::Device) -> ash::Device {
    let load = |name: &CStr| match OF_THE_DRIVER.contains(&name) {
        // SAFETY: the device is alive.
        true => unsafe { instance.get_device_proc_addr(device.handle(), name.as_ptr()) }
            .map_or(std::ptr::null(), |function| function as *const c_void),
        false => own(name),
    };
    // SAFETY: every address is null, the device's function of that name, or one of this file with its type.
    unsafe { ash::Device::load_with(load, device.handle()) }
}

/// Returns VK_KHR_push_descriptor with commands that are dropped.
pub(super) fn push_descriptor(device: &ash::Device) -> ash::khr::push_descriptor::Device {
    unsafe extern "system" fn address(_: vk::Device, name: *const c_char) -> vk::PFN_vkVoidFunction {
        // SAFETY: a name of the crate ash; the address is null or a function's.
        unsafe { std::mem::transmute(own(CStr::from_ptr(name))) }
    }
    let load = |name: &CStr| match name == c"vkGetDeviceProcAddr" {
        true => address as *const c_void,
        false => std::ptr::null(),
    };
    // SAFETY: nothing but that function is called of this instance, which does not look at its handle.
    unsafe {
        let instance = ash::Instance::load_with(load, vk::Instance::null());
        ash::khr::push_descriptor::Device::new(&instance, device)
    }
}

/// Returns a unique number for a handle without contents.
fn number() -> u64 {
    static NEXT: AtomicU64 = AtomicU64::new(1);
    NEXT.fetch_add(1, Ordering::Relaxed)
}

/// Writes a handle without contents.
///
/// # Safety
/// `out` can be written.
unsafe fn make<T: Handle>(out: *mut T) {
    // SAFETY: the caller's word.
    unsafe { out.write(T::from_raw(number())) };
}

/// Memory that a handle points to.
struct Memory {
    start: *mut u8,
    layout: Layout,
}

type Callbacks = *const vk::AllocationCallbacks<'static>;

/// Defines functions with their Vulkan names. The last parameter of `make` functions receives the handle.
macro_rules! functions {
    (@body done) => { vk::Result::SUCCESS };
    (@body nothing) => { {} };
    (@type done) => { vk::Result };
    (@type nothing) => { () };
    (
        own { $($own_name:literal $own:ident;)* }
        make { $($make_name:literal $make:ident($info:ty) -> $handle:ty;)* }
        destroy { $($destroy_name:literal $destroy:ident($gone:ty);)* }
        rest { $($name:literal $kind:ident $function:ident($($type:ty),*);)* }
    ) => {
        $(unsafe extern "system" fn $make(_: vk::Device, _: *const $info, _: Callbacks, out: *mut $handle) -> vk::Result {
            // SAFETY: the caller's pointer.
            unsafe { make(out) };
            vk::Result::SUCCESS
        })*
        $(unsafe extern "system" fn $destroy(_: vk::Device, _: $gone, _: Callbacks) {})*
        $(unsafe extern "system" fn $function($(_: $type),*) -> functions!(@type $kind) { functions!(@body $kind) })*
        /// Returns this file's function of a name; null without one.
        fn own(name: &CStr) -> *const c_void {
            match name.to_bytes() {
                $($own_name => $own as *const c_void,)*
                $($make_name => $make as *const c_void,)*
                $($destroy_name => $destroy as *const c_void,)*
                $($name => $function as *const c_void,)*
                _ => std::ptr::null(),
            }
        }
    };
}

functions! {
    own {
        b"vkAllocateMemory" allocate_memory;
        b"vkFreeMemory" free_memory;
        b"vkMapMemory" map_memory;
        b"vkCreateBuffer" create_buffer;
        b"vkDestroyBuffer" destroy_buffer;
        b"vkGetBufferMemoryRequirements" buffer_requirements;
        b"vkGetImageMemoryRequirements" image_requirements;
        b"vkAllocateCommandBuffers" allocate_commands;
        b"vkAllocateDescriptorSets" allocate_sets;
        b"vkGetQueryPoolResults" query_results;
        b"vkGetEventStatus" event_status;
    }
    make {
        b"vkCreateBufferView" create_buffer_view(vk::BufferViewCreateInfo<'static>) -> vk::BufferView;
        b"vkCreateCommandPool" create_command_pool(vk::CommandPoolCreateInfo<'static>) -> vk::CommandPool;
        b"vkCreateDescriptorPool" create_descriptor_pool(vk::DescriptorPoolCreateInfo<'static>) -> vk::DescriptorPool;
        b"vkCreateEvent" create_event(vk::EventCreateInfo<'static>) -> vk::Event;
        b"vkCreateFence" create_fence(vk::FenceCreateInfo<'static>) -> vk::Fence;
        b"vkCreateImage" create_image(vk::ImageCreateInfo<'static>) -> vk::Image;
        b"vkCreateImageView" create_image_view(vk::ImageViewCreateInfo<'static>) -> vk::ImageView;
        b"vkCreateQueryPool" create_query_pool(vk::QueryPoolCreateInfo<'static>) -> vk::QueryPool;
    }
    destroy {
        b"vkDestroyBufferView" destroy_buffer_view(vk::BufferView);
        b"vkDestroyCommandPool" destroy_command_pool(vk::CommandPool);
        b"vkDestroyDescriptorPool" destroy_descriptor_pool(vk::DescriptorPool);
        b"vkDestroyEvent" destroy_event(vk::Event);
        b"vkDestroyFence" destroy_fence(vk::Fence);
        b"vkDestroyImage" destroy_image(vk::Image);
        b"vkDestroyImageView" destroy_image_view(vk::ImageView);
        b"vkDestroyQueryPool" destroy_query_pool(vk::QueryPool);
    }
    rest {
        b"vkBeginCommandBuffer" done begin(vk::CommandBuffer, *const vk::CommandBufferBeginInfo<'static>);
        b"vkBindBufferMemory" done bind_buffer(vk::Device, vk::Buffer, vk::DeviceMemory, u64);
        b"vkBindImageMemory" done bind_image(vk::Device, vk::Image, vk::DeviceMemory, u64);
        b"vkCmdBindDescriptorSets" nothing bind_sets(
            vk::CommandBuffer, vk::PipelineBindPoint, vk::PipelineLayout, u32, u32, *const vk::DescriptorSet, u32, *const u32
        );
        b"vkCmdBindPipeline" nothing bind_pipeline(vk::CommandBuffer, vk::PipelineBindPoint, vk::Pipeline);
        b"vkCmdCopyBuffer" nothing copy_buffer(vk::CommandBuffer, vk::Buffer, vk::Buffer, u32, *const vk::BufferCopy);
        b"vkCmdCopyBufferToImage" nothing copy_to_image(
            vk::CommandBuffer, vk::Buffer, vk::Image, vk::ImageLayout, u32, *const vk::BufferImageCopy
        );
        b"vkCmdCopyImageToBuffer" nothing copy_from_image(
            vk::CommandBuffer, vk::Image, vk::ImageLayout, vk::Buffer, u32, *const vk::BufferImageCopy
        );
        b"vkCmdDispatch" nothing dispatch(vk::CommandBuffer, u32, u32, u32);
        b"vkCmdDispatchIndirect" nothing dispatch_indirect(vk::CommandBuffer, vk::Buffer, u64);
        b"vkCmdFillBuffer" nothing fill(vk::CommandBuffer, vk::Buffer, u64, u64, u32);
        b"vkCmdPipelineBarrier2" nothing barrier(vk::CommandBuffer, *const vk::DependencyInfo<'static>);
        b"vkCmdPushConstants" nothing push_constants(
            vk::CommandBuffer, vk::PipelineLayout, vk::ShaderStageFlags, u32, u32, *const c_void
        );
        b"vkCmdPushDescriptorSetKHR" nothing push_set(
            vk::CommandBuffer, vk::PipelineBindPoint, vk::PipelineLayout, u32, u32, *const vk::WriteDescriptorSet<'static>
        );
        b"vkCmdResetQueryPool" nothing reset_queries(vk::CommandBuffer, vk::QueryPool, u32, u32);
        b"vkCmdSetEvent2" nothing set_event(vk::CommandBuffer, vk::Event, *const vk::DependencyInfo<'static>);
        b"vkCmdUpdateBuffer" nothing update(vk::CommandBuffer, vk::Buffer, u64, u64, *const c_void);
        b"vkCmdWriteTimestamp2" nothing timestamp(vk::CommandBuffer, vk::PipelineStageFlags2, vk::QueryPool, u32);
        b"vkDeviceWaitIdle" done wait_device(vk::Device);
        b"vkEndCommandBuffer" done end(vk::CommandBuffer);
        b"vkQueueSubmit2" done submit(vk::Queue, u32, *const vk::SubmitInfo2<'static>, vk::Fence);
        b"vkQueueWaitIdle" done wait_queue(vk::Queue);
        b"vkResetCommandPool" done reset_commands(vk::Device, vk::CommandPool, vk::CommandPoolResetFlags);
        b"vkResetEvent" done reset_event(vk::Device, vk::Event);
        b"vkResetFences" done reset_fences(vk::Device, u32, *const vk::Fence);
        b"vkUnmapMemory" nothing unmap(vk::Device, vk::DeviceMemory);
        b"vkUpdateDescriptorSets" nothing update_sets(
            vk::Device, u32, *const vk::WriteDescriptorSet<'static>, u32, *const vk::CopyDescriptorSet<'static>
        );
        b"vkWaitForFences" done wait_fences(vk::Device, u32, *const vk::Fence, vk::Bool32, u64);
    }
}

unsafe extern "system" fn allocate_memory(
    _: vk::Device,
    info: *const vk::MemoryAllocateInfo<'_>,
    _: Callbacks,
    out: *mut vk::DeviceMemory,
) -> vk::Result {
    // SAFETY: the caller's pointers; the layout is not empty.
    unsafe {
        let bytes = usize::try_from((*info).allocation_size).unwrap_or(usize::MAX).max(1);
        let Ok(layout) = Layout::from_size_align(bytes, HOST_ALIGNMENT) else {
            return vk::Result::ERROR_OUT_OF_HOST_MEMORY;
        };
        let start = alloc_zeroed(layout);
        if start.is_null() {
            return vk::Result::ERROR_OUT_OF_DEVICE_MEMORY;
        }
        out.write(vk::DeviceMemory::from_raw(Box::into_raw(Box::new(Memory { start, layout })) as u64));
    }
    vk::Result::SUCCESS
}

unsafe extern "system" fn free_memory(_: vk::Device, memory: vk::DeviceMemory, _: Callbacks) {
    if memory != vk::DeviceMemory::null() {
        // SAFETY: a handle of `allocate_memory`, which is freed once.
        unsafe {
            let memory = Box::from_raw(memory.as_raw() as *mut Memory);
            dealloc(memory.start, memory.layout);
        }
    }
}

unsafe extern "system" fn map_memory(
    _: vk::Device,
    memory: vk::DeviceMemory,
    offset: u64,
    _: u64,
    _: vk::MemoryMapFlags,
    out: *mut *mut c_void,
) -> vk::Result {
    // SAFETY: a handle of `allocate_memory`; the caller's offset lies within.
    unsafe { out.write((*(memory.as_raw() as *const Memory)).start.add(offset as usize).cast()) };
    vk::Result::SUCCESS
}

/// A buffer's handle points to its size.
unsafe extern "system" fn create_buffer(
    _: vk::Device,
    info: *const vk::BufferCreateInfo<'_>,
    _: Callbacks,
    out: *mut vk::Buffer,
) -> vk::Result {
    // SAFETY: the caller's pointers.
    unsafe { out.write(vk::Buffer::from_raw(Box::into_raw(Box::new((*info).size)) as u64)) };
    vk::Result::SUCCESS
}

unsafe extern "system" fn destroy_buffer(_: vk::Device, buffer: vk::Buffer, _: Callbacks) {
    if buffer != vk::Buffer::null() {
        // SAFETY: a handle of `create_buffer`, which is destroyed once.
        drop(unsafe { Box::from_raw(buffer.as_raw() as *mut u64) });
    }
}

fn requirements(bytes: u64) -> vk::MemoryRequirements {
    let size = bytes.next_multiple_of(ALIGNMENT);
    vk::MemoryRequirements { size, alignment: ALIGNMENT, memory_type_bits: 1 }
}

unsafe extern "system" fn buffer_requirements(
    _: vk::Device,
    buffer: vk::Buffer,
    out: *mut vk::MemoryRequirements,
) {
    // SAFETY: a handle of `create_buffer`; the caller's pointer.
    unsafe { out.write(requirements(*(buffer.as_raw() as *const u64))) };
}

/// Nothing reads an image, so any size suffices.
unsafe extern "system" fn image_requirements(_: vk::Device, _: vk::Image, out: *mut vk::MemoryRequirements) {
    // SAFETY: the caller's pointer.
    unsafe { out.write(requirements(ALIGNMENT)) };
}

unsafe extern "system" fn allocate_commands(
    _: vk::Device,
    info: *const vk::CommandBufferAllocateInfo<'_>,
    out: *mut vk::CommandBuffer,
) -> vk::Result {
    // SAFETY: the caller's pointers, with as many places as it asks for.
    unsafe {
        for k in 0..(*info).command_buffer_count as usize {
            make(out.add(k));
        }
    }
    vk::Result::SUCCESS
}

unsafe extern "system" fn allocate_sets(
    _: vk::Device,
    info: *const vk::DescriptorSetAllocateInfo<'_>,
    out: *mut vk::DescriptorSet,
) -> vk::Result {
    // SAFETY: as above.
    unsafe {
        for k in 0..(*info).descriptor_set_count as usize {
            make(out.add(k));
        }
    }
    vk::Result::SUCCESS
}

unsafe extern "system" fn query_results(
    _: vk::Device,
    _: vk::QueryPool,
    _: u32,
    _: u32,
    bytes: usize,
    out: *mut c_void,
    _: u64,
    _: vk::QueryResultFlags,
) -> vk::Result {
    // SAFETY: the caller has so many bytes there.
    unsafe { out.cast::<u8>().write_bytes(0, bytes) };
    vk::Result::SUCCESS
}

unsafe extern "system" fn event_status(_: vk::Device, _: vk::Event) -> vk::Result {
    vk::Result::EVENT_SET
}
