//! For tests: Vulkan calls that fail on demand.
//!
//! [`super::ContextOptions::faults`] counts the calls that may fail: functions of [`RawDevice`] that hide those of
//! `ash::Device`. A call is either passed on or answered with an error, like a driver's. Code above cannot tell the
//! difference. The validation layer is below and sees a program that handles the error.

use super::lock::lock;
use super::open_device::RawDevice;
use ash::prelude::VkResult;
use ash::vk;
use std::collections::HashMap;
use std::sync::{Arc, Mutex};

/// A function that fails, and its result.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Fault {
    /// vkAllocateMemory: out of device memory.
    Allocation,
    /// vkQueueSubmit2: the device is lost and stays lost.
    SubmitLost,
    /// vkWaitForFences: the device is lost and stays lost.
    WaitLost,
    /// vkWaitForFences: timeout.
    Timeout,
    /// vkWaitForFences: out of host memory.
    WaitMemory,
    /// vkQueueSubmit2: a panic instead of an error, for callers that catch panics.
    Panic,
    /// Any other call that may fail (creation, binding, mapping, resetting, recording, submission): out of host memory.
    Object,
}

/// Number of calls of one kind, and which of them fail.
#[derive(Clone, Copy, Debug, Default)]
struct Counter {
    calls: u64,
    /// Index of the first failing call, and the number of failing calls from there.
    fails: Option<(u64, u64)>,
}

#[derive(Default)]
struct State {
    counters: HashMap<Fault, Counter>,
    /// Functions of [`Fault::Object`] in the order of their calls.
    objects: Vec<&'static str>,
    injected: u64,
    lost: bool,
}

/// Which calls of a device fail. Clones share their state.
#[derive(Clone, Default)]
pub struct Faults(Arc<Mutex<State>>);

impl std::fmt::Debug for Faults {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Faults({} injected)", self.injected())
    }
}

impl Faults {
    /// Creates faults that do not fail any call yet.
    pub fn new() -> Self {
        Self::default()
    }

    fn with<T>(&self, f: impl FnOnce(&mut State) -> T) -> T {
        f(&mut lock(&self.0))
    }

    /// Makes only the `index`-th call from now on fail, counted from 0.
    pub fn arm(&self, fault: Fault, index: u64) {
        self.arm_many(fault, index, 1);
    }

    /// Same as [`Faults::arm`], but for `count` calls from there on.
    pub fn arm_many(&self, fault: Fault, index: u64, count: u64) {
        self.with(|state| {
            state.objects.clear();
            state.counters.insert(fault, Counter { calls: 0, fails: Some((index, count)) })
        });
    }

    /// Turns all faults off, and restarts the count.
    pub fn disarm(&self) {
        self.with(|state| {
            state.objects.clear();
            state.counters.clear();
        });
    }

    /// Returns the number of calls of a kind since [`Faults::arm`] or [`Faults::disarm`].
    pub fn calls(&self, fault: Fault) -> u64 {
        self.with(|state| state.counters.get(&fault).map_or(0, |counter| counter.calls))
    }

    /// Returns the functions that [`Fault::Object`] counts, in call order, since [`Faults::arm`] or [`Faults::disarm`].
    pub fn objects(&self) -> Vec<&'static str> {
        self.with(|state| state.objects.clone())
    }

    /// Returns the number of failed calls, except those on a lost device.
    pub fn injected(&self) -> u64 {
        self.with(|state| state.injected)
    }

    pub(super) fn strikes(&self, fault: Fault) -> bool {
        self.with(|state| {
            let counter = state.counters.entry(fault).or_default();
            let strikes = counter.fails.is_some_and(|(first, count)| {
                counter.calls.checked_sub(first).is_some_and(|since| since < count)
            });
            counter.calls += 1;
            state.injected += u64::from(strikes);
            state.lost |= strikes && matches!(fault, Fault::SubmitLost | Fault::WaitLost);
            strikes
        })
    }

    /// Counts a call for [`Fault::Object`]. Returns true if it fails.
    pub(super) fn strikes_object(&self, function: &'static str) -> bool {
        self.with(|state| state.objects.push(function));
        self.strikes(Fault::Object)
    }

    pub(super) fn lost(&self) -> bool {
        self.with(|state| state.lost)
    }
}

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
