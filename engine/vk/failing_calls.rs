//! For tests: functions of [`RawDevice`] that hide those of `ash::Device` and fail as [`super::Faults`] says.

use super::faults::Fault;
use super::open_device::RawDevice;
use ash::prelude::VkResult;
use ash::vk;

type Callbacks<'a> = Option<&'a vk::AllocationCallbacks<'a>>;

impl RawDevice {
    fn strikes(&self, fault: Fault) -> bool {
        self.faults.as_ref().is_some_and(|faults| faults.strikes(fault))
    }

    /// Counts a call for [`Fault::Object`].
    fn object(&self, function: &'static str) -> VkResult<()> {
        let strikes = self.faults.as_ref().is_some_and(|faults| faults.strikes_object(function));
        if strikes { Err(vk::Result::ERROR_OUT_OF_HOST_MEMORY) } else { Ok(()) }
    }

    fn is_lost(&self) -> bool {
        self.faults.as_ref().is_some_and(|faults| faults.lost())
    }
}

/// Defines device calls that fail on demand: functions that hide those of `ash::Device` with the same names.
macro_rules! objects {
    (@result) => { () };
    (@result $out:ty) => { $out };
    ($($function:ident($($argument:ident: $type:ty),*) $(-> $out:ty)?;)*) => {
        impl RawDevice {
            $(
                /// # Safety
                /// Same as the function that it hides.
                pub(super) unsafe fn $function(&self, $($argument: $type),*) -> VkResult<objects!(@result $($out)?)> {
                    self.object(stringify!($function))?;
                    // SAFETY: the caller's arguments, passed on as they are.
                    unsafe { self.raw.$function($($argument),*) }
                }
            )*
        }
    };
}

objects! {
    create_buffer(info: &vk::BufferCreateInfo<'_>, callbacks: Callbacks<'_>) -> vk::Buffer;
    bind_buffer_memory(buffer: vk::Buffer, memory: vk::DeviceMemory, offset: u64);
    map_memory(memory: vk::DeviceMemory, offset: u64, size: u64, flags: vk::MemoryMapFlags) -> *mut std::ffi::c_void;
    create_command_pool(info: &vk::CommandPoolCreateInfo<'_>, callbacks: Callbacks<'_>) -> vk::CommandPool;
    reset_command_pool(pool: vk::CommandPool, flags: vk::CommandPoolResetFlags);
    allocate_command_buffers(info: &vk::CommandBufferAllocateInfo<'_>) -> Vec<vk::CommandBuffer>;
    begin_command_buffer(commands: vk::CommandBuffer, info: &vk::CommandBufferBeginInfo<'_>);
    end_command_buffer(commands: vk::CommandBuffer);
    create_fence(info: &vk::FenceCreateInfo<'_>, callbacks: Callbacks<'_>) -> vk::Fence;
    reset_fences(fences: &[vk::Fence]);
    create_query_pool(info: &vk::QueryPoolCreateInfo<'_>, callbacks: Callbacks<'_>) -> vk::QueryPool;
    get_query_pool_results(pool: vk::QueryPool, first: u32, data: &mut [u64], flags: vk::QueryResultFlags);
    create_shader_module(info: &vk::ShaderModuleCreateInfo<'_>, callbacks: Callbacks<'_>) -> vk::ShaderModule;
    create_descriptor_set_layout(info: &vk::DescriptorSetLayoutCreateInfo<'_>, callbacks: Callbacks<'_>) -> vk::DescriptorSetLayout;
    create_pipeline_layout(info: &vk::PipelineLayoutCreateInfo<'_>, callbacks: Callbacks<'_>) -> vk::PipelineLayout;
    create_buffer_view(info: &vk::BufferViewCreateInfo<'_>, callbacks: Callbacks<'_>) -> vk::BufferView;
    create_descriptor_pool(info: &vk::DescriptorPoolCreateInfo<'_>, callbacks: Callbacks<'_>) -> vk::DescriptorPool;
    allocate_descriptor_sets(info: &vk::DescriptorSetAllocateInfo<'_>) -> Vec<vk::DescriptorSet>;
    create_image(info: &vk::ImageCreateInfo<'_>, callbacks: Callbacks<'_>) -> vk::Image;
    bind_image_memory(image: vk::Image, memory: vk::DeviceMemory, offset: u64);
    create_image_view(info: &vk::ImageViewCreateInfo<'_>, callbacks: Callbacks<'_>) -> vk::ImageView;
    create_event(info: &vk::EventCreateInfo<'_>, callbacks: Callbacks<'_>) -> vk::Event;
    get_event_status(event: vk::Event) -> bool;
    reset_event(event: vk::Event);
}

impl RawDevice {
    /// # Safety
    /// Same as the function that it hides.
    pub(super) unsafe fn create_compute_pipelines(
        &self,
        cache: vk::PipelineCache,
        infos: &[vk::ComputePipelineCreateInfo<'_>],
        callbacks: Callbacks<'_>,
    ) -> Result<Vec<vk::Pipeline>, (Vec<vk::Pipeline>, vk::Result)> {
        self.object("create_compute_pipelines").map_err(|error| (Vec::new(), error))?;
        // SAFETY: the caller's arguments, passed on as they are.
        unsafe { self.raw.create_compute_pipelines(cache, infos, callbacks) }
    }

    /// # Safety
    /// Same as the function that it hides.
    pub(super) unsafe fn allocate_memory(
        &self,
        info: &vk::MemoryAllocateInfo<'_>,
        callbacks: Callbacks<'_>,
    ) -> VkResult<vk::DeviceMemory> {
        if self.strikes(Fault::Allocation) {
            return Err(vk::Result::ERROR_OUT_OF_DEVICE_MEMORY);
        }
        // SAFETY: the caller's arguments, passed on as they are.
        unsafe { self.raw.allocate_memory(info, callbacks) }
    }

    /// # Safety
    /// Same as the function that it hides.
    pub(super) unsafe fn queue_submit2(
        &self,
        queue: vk::Queue,
        submits: &[vk::SubmitInfo2<'_>],
        fence: vk::Fence,
    ) -> VkResult<()> {
        assert!(!self.strikes(Fault::Panic), "a panic that a test wants");
        if self.strikes(Fault::SubmitLost) || self.is_lost() {
            return Err(vk::Result::ERROR_DEVICE_LOST);
        }
        self.object("queue_submit2")?;
        // SAFETY: the caller's arguments, passed on as they are.
        unsafe { self.raw.queue_submit2(queue, submits, fence) }
    }

    /// # Safety
    /// Same as the function that it hides.
    pub(super) unsafe fn wait_for_fences(
        &self,
        fences: &[vk::Fence],
        all: bool,
        timeout: u64,
    ) -> VkResult<()> {
        if self.strikes(Fault::Timeout) {
            return Err(vk::Result::TIMEOUT);
        }
        if self.strikes(Fault::WaitMemory) {
            return Err(vk::Result::ERROR_OUT_OF_HOST_MEMORY);
        }
        let lost = self.strikes(Fault::WaitLost) || self.is_lost();
        // A lost device runs nothing any more. This one still does, so wait for it.
        let timeout = if lost { u64::MAX } else { timeout };
        // SAFETY: the caller's arguments, passed on as they are, but for the timeout.
        let result = unsafe { self.raw.wait_for_fences(fences, all, timeout) };
        if lost { Err(vk::Result::ERROR_DEVICE_LOST) } else { result }
    }
}
