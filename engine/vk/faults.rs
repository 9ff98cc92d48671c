//! For tests: Vulkan calls that fail on demand.
//!
//! With [`super::ContextOptions::faults`], the device's function table has wrappers for the functions that
//! may fail. A wrapper counts its call and either passes it on or returns an error, as a driver would. Code
//! above the table cannot tell the difference. The validation layer is below it and sees a program that
//! handles the error.

use ash::vk::{self, Handle};
use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

/// The function that fails, and its result.
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
    /// Any other call that may fail (creation, binding, mapping, resetting, recording, submission): out of host memory.
    Object,
}

/// The number of calls of one kind, and which of them fail.
#[derive(Clone, Copy, Debug, Default)]
struct Counter {
    calls: u64,
    /// The first call that fails, and the number of calls from it on that fail.
    fails: Option<(u64, u64)>,
}

#[derive(Default)]
struct State {
    counters: HashMap<Fault, Counter>,
    /// The functions of [`Fault::Object`] in the order of their calls.
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
    /// Nothing fails yet.
    pub fn new() -> Self {
        Self::default()
    }

    fn with<T>(&self, f: impl FnOnce(&mut State) -> T) -> T {
        f(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// Makes only the `index`-th call from now on fail, counted from 0.
    pub fn arm(&self, fault: Fault, index: u64) {
        self.arm_many(fault, index, 1);
    }

    /// Like [`Faults::arm`], for `count` calls from there on.
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

    /// Calls of a kind since [`Faults::arm`] or [`Faults::disarm`].
    pub fn calls(&self, fault: Fault) -> u64 {
        self.with(|state| state.counters.get(&fault).map_or(0, |counter| counter.calls))
    }

    /// The functions that [`Fault::Object`] counts, call by call since [`Faults::arm`] or [`Faults::disarm`].
    pub fn objects(&self) -> Vec<&'static str> {
        self.with(|state| state.objects.clone())
    }

    /// Number of calls made to fail, except those on a lost device.
    pub fn injected(&self) -> u64 {
        self.with(|state| state.injected)
    }

    /// Counts a call. Returns whether it fails.
    fn strikes(&self, fault: Fault) -> bool {
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

    /// Counts a call of one of the many functions. Returns whether it fails.
    fn strikes_object(&self, function: &'static str) -> bool {
        self.with(|state| state.objects.push(function));
        self.strikes(Fault::Object)
    }

    fn lost(&self) -> bool {
        self.with(|state| state.lost)
    }
}

/// A device's faults and its real functions.
struct Installed {
    faults: Faults,
    v1_0: ash::DeviceFnV1_0,
    v1_3: ash::DeviceFnV1_3,
}

/// By device, queue and command buffer. Function pointers carry nothing: where their state lies must be known to all.
static INSTALLED: Mutex<Vec<(u64, Arc<Installed>)>> = Mutex::new(Vec::new());

fn installed(handle: u64) -> Option<Arc<Installed>> {
    let all = INSTALLED.lock().unwrap_or_else(PoisonError::into_inner);
    all.iter().rev().find(|(key, _)| *key == handle).map(|(_, installed)| installed.clone())
}

/// Forgets a device, before its handle may mean another.
pub(super) fn remove(device: vk::Device) {
    let Some(gone) = installed(device.as_raw()) else { return };
    INSTALLED.lock().unwrap_or_else(PoisonError::into_inner).retain(|(_, other)| !Arc::ptr_eq(other, &gone));
}

/// Maps a handle to the functions. Any earlier mapping is replaced.
fn register(handle: u64, state: &Arc<Installed>) {
    let mut all = INSTALLED.lock().unwrap_or_else(PoisonError::into_inner);
    all.retain(|(other, _)| *other != handle);
    all.push((handle, state.clone()));
}

/// The device with wrappers in its function table.
pub(super) fn install(device: &ash::Device, queue: Option<vk::Queue>, faults: &Faults) -> ash::Device {
    let (mut v1_0, mut v1_3) = (device.fp_v1_0().clone(), device.fp_v1_3().clone());
    let state = Arc::new(Installed { faults: faults.clone(), v1_0: v1_0.clone(), v1_3: v1_3.clone() });
    register(device.handle().as_raw(), &state);
    queue.iter().for_each(|queue| register(queue.as_raw(), &state));
    wrap_objects(&mut v1_0);
    v1_0.allocate_command_buffers = allocate_command_buffers;
    v1_0.begin_command_buffer = begin_command_buffer;
    v1_0.end_command_buffer = end_command_buffer;
    v1_0.allocate_memory = allocate_memory;
    v1_0.wait_for_fences = wait_for_fences;
    v1_3.queue_submit2 = queue_submit2;
    let (v1_1, v1_2) = (device.fp_v1_1().clone(), device.fp_v1_2().clone());
    ash::Device::from_parts_1_3(device.handle(), v1_0, v1_1, v1_2, v1_3)
}

/// Wrappers of functions that take a device and answer with a result, for [`Fault::Object`].
macro_rules! objects {
    ($($function:ident($($argument:ident: $type:ty),*);)*) => {
        $(
            /// # Safety
            /// As the function that it stands for.
            unsafe extern "system" fn $function(device: vk::Device, $($argument: $type),*) -> vk::Result {
                match installed(device.as_raw()) {
                    Some(i) if i.faults.strikes_object(stringify!($function)) => {
                        vk::Result::ERROR_OUT_OF_HOST_MEMORY
                    }
                    // SAFETY: the caller's arguments, passed on as they are.
                    Some(i) => unsafe { (i.v1_0.$function)(device, $($argument),*) },
                    None => vk::Result::ERROR_UNKNOWN,
                }
            }
        )*

        fn wrap_objects(table: &mut ash::DeviceFnV1_0) {
            $(table.$function = $function;)*
        }
    };
}

objects! {
    create_buffer(info: *const vk::BufferCreateInfo<'_>, callbacks: *const vk::AllocationCallbacks<'_>, out: *mut vk::Buffer);
    bind_buffer_memory(buffer: vk::Buffer, memory: vk::DeviceMemory, offset: vk::DeviceSize);
    map_memory(memory: vk::DeviceMemory, offset: vk::DeviceSize, size: vk::DeviceSize, flags: vk::MemoryMapFlags, out: *mut *mut std::ffi::c_void);
    create_command_pool(info: *const vk::CommandPoolCreateInfo<'_>, callbacks: *const vk::AllocationCallbacks<'_>, out: *mut vk::CommandPool);
    reset_command_pool(pool: vk::CommandPool, flags: vk::CommandPoolResetFlags);
    create_fence(info: *const vk::FenceCreateInfo<'_>, callbacks: *const vk::AllocationCallbacks<'_>, out: *mut vk::Fence);
    reset_fences(count: u32, fences: *const vk::Fence);
    create_query_pool(info: *const vk::QueryPoolCreateInfo<'_>, callbacks: *const vk::AllocationCallbacks<'_>, out: *mut vk::QueryPool);
    get_query_pool_results(pool: vk::QueryPool, first: u32, count: u32, bytes: usize, data: *mut std::ffi::c_void, stride: vk::DeviceSize, flags: vk::QueryResultFlags);
    create_shader_module(info: *const vk::ShaderModuleCreateInfo<'_>, callbacks: *const vk::AllocationCallbacks<'_>, out: *mut vk::ShaderModule);
    create_descriptor_set_layout(info: *const vk::DescriptorSetLayoutCreateInfo<'_>, callbacks: *const vk::AllocationCallbacks<'_>, out: *mut vk::DescriptorSetLayout);
    create_pipeline_layout(info: *const vk::PipelineLayoutCreateInfo<'_>, callbacks: *const vk::AllocationCallbacks<'_>, out: *mut vk::PipelineLayout);
    create_buffer_view(info: *const vk::BufferViewCreateInfo<'_>, callbacks: *const vk::AllocationCallbacks<'_>, out: *mut vk::BufferView);
    create_descriptor_pool(info: *const vk::DescriptorPoolCreateInfo<'_>, callbacks: *const vk::AllocationCallbacks<'_>, out: *mut vk::DescriptorPool);
    allocate_descriptor_sets(info: *const vk::DescriptorSetAllocateInfo<'_>, out: *mut vk::DescriptorSet);
    create_image(info: *const vk::ImageCreateInfo<'_>, callbacks: *const vk::AllocationCallbacks<'_>, out: *mut vk::Image);
    bind_image_memory(image: vk::Image, memory: vk::DeviceMemory, offset: vk::DeviceSize);
    create_image_view(info: *const vk::ImageViewCreateInfo<'_>, callbacks: *const vk::AllocationCallbacks<'_>, out: *mut vk::ImageView);
    create_event(info: *const vk::EventCreateInfo<'_>, callbacks: *const vk::AllocationCallbacks<'_>, out: *mut vk::Event);
    get_event_status(event: vk::Event);
    reset_event(event: vk::Event);
    create_compute_pipelines(cache: vk::PipelineCache, count: u32, infos: *const vk::ComputePipelineCreateInfo<'_>, callbacks: *const vk::AllocationCallbacks<'_>, out: *mut vk::Pipeline);
}

/// Command buffers lead to their device's functions from here on.
///
/// # Safety
/// As vkAllocateCommandBuffers.
unsafe extern "system" fn allocate_command_buffers(
    device: vk::Device,
    info: *const vk::CommandBufferAllocateInfo<'_>,
    out: *mut vk::CommandBuffer,
) -> vk::Result {
    let Some(i) = installed(device.as_raw()) else { return vk::Result::ERROR_UNKNOWN };
    if i.faults.strikes_object("allocate_command_buffers") {
        return vk::Result::ERROR_OUT_OF_HOST_MEMORY;
    }
    // SAFETY: the caller's arguments, passed on as they are; on success there are as many handles as were asked for.
    unsafe {
        let result = (i.v1_0.allocate_command_buffers)(device, info, out);
        if result == vk::Result::SUCCESS {
            let handles = std::slice::from_raw_parts(out, (*info).command_buffer_count as usize);
            handles.iter().for_each(|commands| register(commands.as_raw(), &i));
        }
        result
    }
}

/// # Safety
/// As vkBeginCommandBuffer, for a command buffer that [`allocate_command_buffers`] has given.
unsafe extern "system" fn begin_command_buffer(
    commands: vk::CommandBuffer,
    info: *const vk::CommandBufferBeginInfo<'_>,
) -> vk::Result {
    match installed(commands.as_raw()) {
        Some(i) if i.faults.strikes_object("begin_command_buffer") => vk::Result::ERROR_OUT_OF_HOST_MEMORY,
        // SAFETY: the caller's arguments, passed on as they are.
        Some(i) => unsafe { (i.v1_0.begin_command_buffer)(commands, info) },
        None => vk::Result::ERROR_UNKNOWN,
    }
}

/// # Safety
/// As vkEndCommandBuffer, for a command buffer that [`allocate_command_buffers`] has given.
unsafe extern "system" fn end_command_buffer(commands: vk::CommandBuffer) -> vk::Result {
    match installed(commands.as_raw()) {
        // It is invalid then, as the specification says: only good for being reset.
        Some(i) if i.faults.strikes_object("end_command_buffer") => vk::Result::ERROR_OUT_OF_HOST_MEMORY,
        // SAFETY: the caller's argument, passed on as it is.
        Some(i) => unsafe { (i.v1_0.end_command_buffer)(commands) },
        None => vk::Result::ERROR_UNKNOWN,
    }
}

/// # Safety
/// As vkAllocateMemory.
unsafe extern "system" fn allocate_memory(
    device: vk::Device,
    info: *const vk::MemoryAllocateInfo<'_>,
    callbacks: *const vk::AllocationCallbacks<'_>,
    out: *mut vk::DeviceMemory,
) -> vk::Result {
    match installed(device.as_raw()) {
        Some(i) if i.faults.strikes(Fault::Allocation) => vk::Result::ERROR_OUT_OF_DEVICE_MEMORY,
        // SAFETY: the caller's arguments, passed on as they are.
        Some(i) => unsafe { (i.v1_0.allocate_memory)(device, info, callbacks, out) },
        None => vk::Result::ERROR_UNKNOWN,
    }
}

/// # Safety
/// As vkQueueSubmit2.
unsafe extern "system" fn queue_submit2(
    queue: vk::Queue,
    count: u32,
    submits: *const vk::SubmitInfo2<'_>,
    fence: vk::Fence,
) -> vk::Result {
    match installed(queue.as_raw()) {
        Some(i) if i.faults.strikes(Fault::SubmitLost) || i.faults.lost() => vk::Result::ERROR_DEVICE_LOST,
        Some(i) if i.faults.strikes_object("queue_submit2") => vk::Result::ERROR_OUT_OF_HOST_MEMORY,
        // SAFETY: the caller's arguments, passed on as they are.
        Some(i) => unsafe { (i.v1_3.queue_submit2)(queue, count, submits, fence) },
        None => vk::Result::ERROR_UNKNOWN,
    }
}

/// # Safety
/// As vkWaitForFences.
unsafe extern "system" fn wait_for_fences(
    device: vk::Device,
    count: u32,
    fences: *const vk::Fence,
    all: vk::Bool32,
    timeout: u64,
) -> vk::Result {
    let Some(i) = installed(device.as_raw()) else { return vk::Result::ERROR_UNKNOWN };
    if i.faults.strikes(Fault::Timeout) {
        return vk::Result::TIMEOUT;
    }
    if i.faults.strikes(Fault::WaitMemory) {
        return vk::Result::ERROR_OUT_OF_HOST_MEMORY;
    }
    let lost = i.faults.strikes(Fault::WaitLost) || i.faults.lost();
    // A lost device runs nothing any more, but this one still does: wait for it.
    let timeout = if lost { u64::MAX } else { timeout };
    // SAFETY: the caller's arguments, passed on as they are, but for the timeout.
    let result = unsafe { (i.v1_0.wait_for_fences)(device, count, fences, all, timeout) };
    if lost { vk::Result::ERROR_DEVICE_LOST } else { result }
}
