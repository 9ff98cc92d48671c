//! A device that compiles kernels and runs nothing, for compiler statistics ([`Context::pipeline_statistics`]).
//!
//! Its function table has the driver's functions for shaders, layouts and pipelines, and this file's for all others. Memory
//! is host memory that begins as zeros, commands are dropped, and submissions finish at once. So a run takes its usual path
//! on drivers that have a compiler and no device, such as Mesa with RADV_FORCE_FAMILY.
//!
//! [`Context::pipeline_statistics`]: super::Context::pipeline_statistics

use super::debug::vk_error;
use crate::error::Result;
use ash::vk::{self, Handle};
use std::alloc::{Layout, alloc_zeroed};
use std::ffi::{CStr, c_char, c_void};
use std::sync::atomic::{AtomicU64, Ordering};

/// Reported size of device memory. The driver may have none.
const HEAP_BYTES: u64 = 1 << 40;
const ALIGNMENT: u64 = 256;

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

/// Writes a unique handle without contents.
///
/// # Safety
/// `out` can be written.
unsafe fn make<T: Handle>(out: *mut T) {
    static NEXT: AtomicU64 = AtomicU64::new(1);
    // SAFETY: the caller's word.
    unsafe { out.write(T::from_raw(NEXT.fetch_add(1, Ordering::Relaxed))) };
}

type Callbacks = *const vk::AllocationCallbacks<'static>;

unsafe extern "system" fn create<I, T: Handle>(
    _: vk::Device,
    _: *const I,
    _: Callbacks,
    out: *mut T,
) -> vk::Result {
    // SAFETY: the caller's pointer.
    unsafe { make(out) };
    vk::Result::SUCCESS
}

unsafe extern "system" fn destroy<T>(_: vk::Device, _: T, _: Callbacks) {}

/// Defines `own`. Functions of `done` and `nothing` have parameters of these types and ignore them.
macro_rules! functions {
    (
        own { $($own:literal $function:expr;)* }
        done { $($done:literal($($done_type:ty),*);)* }
        nothing { $($nothing:literal($($nothing_type:ty),*);)* }
    ) => {
        /// Returns this file's function of a name; null without one.
        fn own(name: &CStr) -> *const c_void {
            match name.to_bytes() {
                $($own => $function as *const c_void,)*
                $($done => {
                    unsafe extern "system" fn done($(_: $done_type),*) -> vk::Result {
                        vk::Result::SUCCESS
                    }
                    done as *const c_void
                })*
                $($nothing => {
                    unsafe extern "system" fn nothing($(_: $nothing_type),*) {}
                    nothing as *const c_void
                })*
                _ => std::ptr::null(),
            }
        }
    };
}

functions! {
    own {
        b"vkAllocateCommandBuffers" allocate_commands;
        b"vkAllocateDescriptorSets" allocate_sets;
        b"vkAllocateMemory" allocate_memory;
        b"vkFreeMemory" free_memory;
        b"vkMapMemory" map_memory;
        b"vkCreateBuffer" create_buffer;
        b"vkDestroyBuffer" destroy_buffer;
        b"vkGetBufferMemoryRequirements" buffer_requirements;
        b"vkGetImageMemoryRequirements" image_requirements;
        b"vkGetQueryPoolResults" query_results;
        b"vkGetEventStatus" event_status;
        b"vkCreateBufferView" create::<vk::BufferViewCreateInfo<'static>, vk::BufferView>;
        b"vkCreateCommandPool" create::<vk::CommandPoolCreateInfo<'static>, vk::CommandPool>;
        b"vkCreateDescriptorPool" create::<vk::DescriptorPoolCreateInfo<'static>, vk::DescriptorPool>;
        b"vkCreateEvent" create::<vk::EventCreateInfo<'static>, vk::Event>;
        b"vkCreateFence" create::<vk::FenceCreateInfo<'static>, vk::Fence>;
        b"vkCreateImage" create::<vk::ImageCreateInfo<'static>, vk::Image>;
        b"vkCreateImageView" create::<vk::ImageViewCreateInfo<'static>, vk::ImageView>;
        b"vkCreateQueryPool" create::<vk::QueryPoolCreateInfo<'static>, vk::QueryPool>;
        b"vkDestroyBufferView" destroy::<vk::BufferView>;
        b"vkDestroyCommandPool" destroy::<vk::CommandPool>;
        b"vkDestroyDescriptorPool" destroy::<vk::DescriptorPool>;
        b"vkDestroyEvent" destroy::<vk::Event>;
        b"vkDestroyFence" destroy::<vk::Fence>;
        b"vkDestroyImage" destroy::<vk::Image>;
        b"vkDestroyImageView" destroy::<vk::ImageView>;
        b"vkDestroyQueryPool" destroy::<vk::QueryPool>;
    }
    done {
        b"vkBeginCommandBuffer"(vk::CommandBuffer, *const vk::CommandBufferBeginInfo<'static>);
        b"vkBindBufferMemory"(vk::Device, vk::Buffer, vk::DeviceMemory, u64);
        b"vkBindImageMemory"(vk::Device, vk::Image, vk::DeviceMemory, u64);
        b"vkDeviceWaitIdle"(vk::Device);
        b"vkEndCommandBuffer"(vk::CommandBuffer);
        b"vkQueueSubmit2"(vk::Queue, u32, *const vk::SubmitInfo2<'static>, vk::Fence);
        b"vkQueueWaitIdle"(vk::Queue);
        b"vkResetCommandPool"(vk::Device, vk::CommandPool, vk::CommandPoolResetFlags);
        b"vkResetEvent"(vk::Device, vk::Event);
        b"vkResetFences"(vk::Device, u32, *const vk::Fence);
        b"vkWaitForFences"(vk::Device, u32, *const vk::Fence, vk::Bool32, u64);
    }
    nothing {
        b"vkCmdBindDescriptorSets"(
            vk::CommandBuffer, vk::PipelineBindPoint, vk::PipelineLayout, u32, u32, *const vk::DescriptorSet, u32, *const u32
        );
        b"vkCmdBindPipeline"(vk::CommandBuffer, vk::PipelineBindPoint, vk::Pipeline);
        b"vkCmdCopyBuffer"(vk::CommandBuffer, vk::Buffer, vk::Buffer, u32, *const vk::BufferCopy);
        b"vkCmdCopyBufferToImage"(
            vk::CommandBuffer, vk::Buffer, vk::Image, vk::ImageLayout, u32, *const vk::BufferImageCopy
        );
        b"vkCmdCopyImageToBuffer"(
            vk::CommandBuffer, vk::Image, vk::ImageLayout, vk::Buffer, u32, *const vk::BufferImageCopy
        );
        b"vkCmdDispatch"(vk::CommandBuffer, u32, u32, u32);
        b"vkCmdDispatchIndirect"(vk::CommandBuffer, vk::Buffer, u64);
        b"vkCmdFillBuffer"(vk::CommandBuffer, vk::Buffer, u64, u64, u32);
        b"vkCmdPipelineBarrier2"(vk::CommandBuffer, *const vk::DependencyInfo<'static>);
        b"vkCmdPushConstants"(
            vk::CommandBuffer, vk::PipelineLayout, vk::ShaderStageFlags, u32, u32, *const c_void
        );
        b"vkCmdPushDescriptorSetKHR"(
            vk::CommandBuffer, vk::PipelineBindPoint, vk::PipelineLayout, u32, u32, *const vk::WriteDescriptorSet<'static>
        );
        b"vkCmdResetQueryPool"(vk::CommandBuffer, vk::QueryPool, u32, u32);
        b"vkCmdSetEvent2"(vk::CommandBuffer, vk::Event, *const vk::DependencyInfo<'static>);
        b"vkCmdUpdateBuffer"(vk::CommandBuffer, vk::Buffer, u64, u64, *const c_void);
        b"vkCmdWriteTimestamp2"(vk::CommandBuffer, vk::PipelineStageFlags2, vk::QueryPool, u32);
        b"vkUnmapMemory"(vk::Device, vk::DeviceMemory);
        b"vkUpdateDescriptorSets"(
            vk::Device, u32, *const vk::WriteDescriptorSet<'static>, u32, *const vk::CopyDescriptorSet<'static>
        );
    }
}

unsafe extern "system" fn allocate_memory(
    _: vk::Device,
    info: *const vk::MemoryAllocateInfo<'_>,
    _: Callbacks,
    out: *mut vk::DeviceMemory,
) -> vk::Result {
    // SAFETY: the caller's pointers; the layout is not empty, and that of the vector, which owns the zeros.
    unsafe {
        let count = (*info).allocation_size.div_ceil(8).max(1) as usize;
        let Ok(layout) = Layout::array::<u64>(count) else { return vk::Result::ERROR_OUT_OF_HOST_MEMORY };
        // The system provides zeros without writing them.
        let start = alloc_zeroed(layout);
        if start.is_null() {
            return vk::Result::ERROR_OUT_OF_DEVICE_MEMORY;
        }
        let words = Vec::from_raw_parts(start.cast::<u64>(), count, count);
        out.write(vk::DeviceMemory::from_raw(Box::into_raw(Box::new(words)) as u64));
    }
    vk::Result::SUCCESS
}

unsafe extern "system" fn free_memory(_: vk::Device, memory: vk::DeviceMemory, _: Callbacks) {
    if memory != vk::DeviceMemory::null() {
        // SAFETY: a handle of `allocate_memory`, which is freed once.
        drop(unsafe { Box::from_raw(memory.as_raw() as *mut Vec<u64>) });
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
    unsafe {
        let words = &mut *(memory.as_raw() as *mut Vec<u64>);
        out.write(words.as_mut_ptr().byte_add(offset as usize).cast());
    }
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
    unsafe { (0..(*info).command_buffer_count as usize).for_each(|k| make(out.add(k))) };
    vk::Result::SUCCESS
}

unsafe extern "system" fn allocate_sets(
    _: vk::Device,
    info: *const vk::DescriptorSetAllocateInfo<'_>,
    out: *mut vk::DescriptorSet,
) -> vk::Result {
    // SAFETY: as above.
    unsafe { (0..(*info).descriptor_set_count as usize).for_each(|k| make(out.add(k))) };
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
    // SAFETY: the caller provides this many bytes.
    unsafe { out.cast::<u8>().write_bytes(0, bytes) };
    vk::Result::SUCCESS
}

unsafe extern "system" fn event_status(_: vk::Device, _: vk::Event) -> vk::Result {
    vk::Result::EVENT_SET
}

/// Options of [`ContextOptions::compile_only`](super::ContextOptions::compile_only).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CompileOnly {
    /// True to collect the compilers' texts, which include machine code.
    pub texts: bool,
}

/// One program of a pipeline.
#[derive(Clone, Debug, PartialEq)]
pub struct Executable {
    /// The driver's name for it.
    pub name: String,
    /// Its subgroup size; 0: unknown to the driver.
    pub subgroup_size: u32,
    /// Its statistics, in the driver's order and words.
    pub statistics: Vec<Statistic>,
    /// With [`CompileOnly::texts`]: (name, text), including machine code.
    pub texts: Vec<(String, String)>,
}

/// A statistic of a compiler.
#[derive(Clone, Debug, PartialEq)]
pub struct Statistic {
    /// The driver's name for it.
    pub name: String,
    /// Its meaning, in the driver's words.
    pub description: String,
    /// Value. Drivers give integers, except for estimates.
    pub value: f64,
}

pub(super) struct Executables {
    functions: ash::khr::pipeline_executable_properties::Device,
    requested: CompileOnly,
}

impl Executables {
    pub(super) fn new(instance: &ash::Instance, device: &ash::Device, requested: CompileOnly) -> Self {
        Self { functions: ash::khr::pipeline_executable_properties::Device::new(instance, device), requested }
    }

    pub(super) fn flags(&self) -> vk::PipelineCreateFlags {
        let texts = match self.requested.texts {
            true => vk::PipelineCreateFlags::CAPTURE_INTERNAL_REPRESENTATIONS_KHR,
            false => vk::PipelineCreateFlags::empty(),
        };
        vk::PipelineCreateFlags::CAPTURE_STATISTICS_KHR | texts
    }

    pub(super) fn of(&self, pipeline: vk::Pipeline) -> Result<Vec<Executable>> {
        let info = vk::PipelineInfoKHR::default().pipeline(pipeline);
        // SAFETY: the pipeline lives as long as the device, and was created with the flags.
        let all = unsafe { self.functions.get_pipeline_executable_properties(&info) }
            .map_err(vk_error("vkGetPipelineExecutablePropertiesKHR"))?;
        let info = vk::PipelineExecutableInfoKHR::default().pipeline(pipeline);
        let each = all.iter().zip(0..).map(|(executable, index)| {
            let info = info.executable_index(index);
            Ok(Executable {
                name: text(&executable.name),
                subgroup_size: executable.subgroup_size,
                statistics: self.statistics(&info)?,
                texts: if self.requested.texts { self.texts(&info)? } else { Vec::new() },
            })
        });
        each.collect()
    }

    fn statistics(&self, info: &vk::PipelineExecutableInfoKHR<'_>) -> Result<Vec<Statistic>> {
        // SAFETY: as above.
        let statistics = unsafe { self.functions.get_pipeline_executable_statistics(info) }
            .map_err(vk_error("vkGetPipelineExecutableStatisticsKHR"))?;
        let of = |statistic: &vk::PipelineExecutableStatisticKHR<'_>| {
            use vk::PipelineExecutableStatisticFormatKHR as Format;
            // SAFETY: the format says which member the driver has written.
            let value = unsafe {
                match statistic.format {
                    Format::BOOL32 => f64::from(statistic.value.b32),
                    Format::INT64 => statistic.value.i64 as f64,
                    Format::UINT64 => statistic.value.u64 as f64,
                    _ => statistic.value.f64,
                }
            };
            Statistic { name: text(&statistic.name), description: text(&statistic.description), value }
        };
        Ok(statistics.iter().map(of).collect())
    }

    fn texts(&self, info: &vk::PipelineExecutableInfoKHR<'_>) -> Result<Vec<(String, String)>> {
        let failed = vk_error("vkGetPipelineExecutableInternalRepresentationsKHR");
        let functions = &self.functions;
        // SAFETY: as above. The first call gives the sizes, the second one writes into memory of these.
        unsafe {
            let mut all =
                functions.get_pipeline_executable_internal_representations(info).map_err(&failed)?;
            let mut bytes: Vec<Vec<u8>> = all.iter().map(|one| vec![0; one.data_size]).collect();
            for (one, bytes) in all.iter_mut().zip(&mut bytes) {
                one.p_data = bytes.as_mut_ptr().cast();
            }
            let mut count = all.len() as u32;
            let get = functions.fp().get_pipeline_executable_internal_representations_khr;
            get(functions.device(), info, &mut count, all.as_mut_ptr()).result().map_err(&failed)?;
            let texts = all.iter().zip(&bytes).filter(|(one, _)| one.is_text != 0).map(|(one, bytes)| {
                let end = bytes.iter().position(|&byte| byte == 0).unwrap_or(bytes.len());
                (text(&one.name), String::from_utf8_lossy(&bytes[..end]).into_owned())
            });
            Ok(texts.collect())
        }
    }
}

/// Returns a driver's text up to its first zero.
fn text(characters: &[c_char]) -> String {
    let bytes: Vec<u8> = characters.iter().map(|&c| c as u8).collect();
    CStr::from_bytes_until_nul(&bytes).unwrap_or_default().to_string_lossy().into_owned()
}
