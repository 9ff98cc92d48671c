//! With `ASHSPLAT_TRACE=FILE`, writes the commands of every command buffer as text, without handles and addresses. Two versions
//! of the program record the same commands if these texts agree. `tools/proof` compares them.

use super::families::slice;
use super::state::DeviceState;
use ash::vk::{self, Handle};
use std::collections::HashMap;
use std::fmt::{Debug, Write as _};
use std::hash::{DefaultHasher, Hash, Hasher};
use std::io::Write as _;
use std::sync::{Mutex, MutexGuard, OnceLock, PoisonError};

/// Hashes of shader modules and pipelines by handle, and the text of each command buffer being recorded.
#[derive(Default)]
struct Trace {
    modules: HashMap<u64, u64>,
    pipelines: HashMap<u64, u64>,
    recordings: HashMap<u64, String>,
}

/// The file; none without tracing.
fn file() -> Option<&'static Mutex<std::fs::File>> {
    static FILE: OnceLock<Option<Mutex<std::fs::File>>> = OnceLock::new();
    let open = || {
        let path = std::env::var_os("ASHSPLAT_TRACE")?;
        let file = std::fs::File::options().create(true).append(true).open(&path);
        Some(Mutex::new(file.unwrap_or_else(|error| panic!("ASHSPLAT_TRACE={}: {error}", path.display()))))
    };
    FILE.get_or_init(open).as_ref()
}

fn trace() -> MutexGuard<'static, Trace> {
    static TRACE: OnceLock<Mutex<Trace>> = OnceLock::new();
    TRACE.get_or_init(Mutex::default).lock().unwrap_or_else(PoisonError::into_inner)
}

fn hashed(value: impl Hash) -> u64 {
    let mut hasher = DefaultHasher::new();
    value.hash(&mut hasher);
    hasher.finish()
}

/// Adds a line to the text of a command buffer.
pub(crate) fn command(commands: vk::CommandBuffer, name: &str, what: impl Debug) {
    if file().is_some() {
        let mut trace = trace();
        let text = trace.recordings.entry(commands.as_raw()).or_default();
        let _ = writeln!(text, "{name} {what:x?}");
    }
}

/// Writes a barrier's masks and layouts, but not its ranges, which differ between runs.
pub(crate) fn barrier(commands: vk::CommandBuffer, info: &vk::DependencyInfo<'_>) {
    // SAFETY: the caller's arrays.
    let (memory, buffers, images) = unsafe {
        (
            slice(info.p_memory_barriers, info.memory_barrier_count),
            slice(info.p_buffer_memory_barriers, info.buffer_memory_barrier_count),
            slice(info.p_image_memory_barriers, info.image_memory_barrier_count),
        )
    };
    for b in memory {
        let masks = (b.src_stage_mask, b.src_access_mask, b.dst_stage_mask, b.dst_access_mask);
        command(commands, "barrier", masks);
    }
    for b in buffers {
        let masks = (b.src_stage_mask, b.src_access_mask, b.dst_stage_mask, b.dst_access_mask, b.size);
        command(commands, "buffer barrier", masks);
    }
    for b in images {
        let masks = (b.src_stage_mask, b.src_access_mask, b.dst_stage_mask, b.dst_access_mask);
        command(commands, "image barrier", (masks, b.old_layout, b.new_layout));
    }
}

pub(crate) unsafe extern "system" fn create_shader_module(
    device: vk::Device,
    info: *const vk::ShaderModuleCreateInfo<'_>,
    callbacks: *const vk::AllocationCallbacks<'_>,
    module: *mut vk::ShaderModule,
) -> vk::Result {
    // SAFETY: the caller's arguments; the module is written by the call.
    unsafe {
        let result = (DeviceState::of(device).v10.create_shader_module)(device, info, callbacks, module);
        if result == vk::Result::SUCCESS && file().is_some() {
            let code = std::slice::from_raw_parts((*info).p_code, (*info).code_size / 4);
            trace().modules.insert((*module).as_raw(), hashed(code));
        }
        result
    }
}

pub(crate) unsafe extern "system" fn create_compute_pipelines(
    device: vk::Device,
    cache: vk::PipelineCache,
    count: u32,
    infos: *const vk::ComputePipelineCreateInfo<'_>,
    callbacks: *const vk::AllocationCallbacks<'_>,
    pipelines: *mut vk::Pipeline,
) -> vk::Result {
    let next = DeviceState::of(device).v10.create_compute_pipelines;
    // SAFETY: the caller's arguments; the pipelines are written by the call.
    unsafe {
        let result = next(device, cache, count, infos, callbacks, pipelines);
        if file().is_some() {
            for index in 0..count as usize {
                let stage = &(*infos.add(index)).stage;
                let constants = stage.p_specialization_info.as_ref().map(|info| {
                    let entries = slice(info.p_map_entries, info.map_entry_count);
                    let entries: Vec<_> = entries.iter().map(|e| (e.constant_id, e.offset, e.size)).collect();
                    let data = std::slice::from_raw_parts(info.p_data.cast::<u8>(), info.data_size);
                    (entries, data.to_vec())
                });
                let mut trace = trace();
                let module = trace.modules.get(&stage.module.as_raw()).copied();
                let hash = hashed((module, constants, stage.flags.as_raw()));
                trace.pipelines.insert((*pipelines.add(index)).as_raw(), hash);
            }
        }
        result
    }
}

pub(crate) unsafe extern "system" fn begin(
    commands: vk::CommandBuffer,
    info: *const vk::CommandBufferBeginInfo<'_>,
) -> vk::Result {
    trace().recordings.remove(&commands.as_raw());
    // SAFETY: the caller's arguments.
    unsafe { (DeviceState::of(commands).v10.begin_command_buffer)(commands, info) }
}

pub(crate) unsafe extern "system" fn end(commands: vk::CommandBuffer) -> vk::Result {
    if let Some(file) = file() {
        let text = trace().recordings.remove(&commands.as_raw()).unwrap_or_default();
        let mut file = file.lock().unwrap_or_else(PoisonError::into_inner);
        let _ = writeln!(file, "{text}end");
    }
    // SAFETY: the caller's argument.
    unsafe { (DeviceState::of(commands).v10.end_command_buffer)(commands) }
}

pub(crate) unsafe extern "system" fn bind_pipeline(
    commands: vk::CommandBuffer,
    point: vk::PipelineBindPoint,
    pipeline: vk::Pipeline,
) {
    if file().is_some() {
        let hash = trace().pipelines.get(&pipeline.as_raw()).copied();
        command(commands, "pipeline", hash);
    }
    // SAFETY: the caller's arguments.
    unsafe { (DeviceState::of(commands).v10.cmd_bind_pipeline)(commands, point, pipeline) }
}

pub(crate) unsafe extern "system" fn push_constants(
    commands: vk::CommandBuffer,
    layout: vk::PipelineLayout,
    stages: vk::ShaderStageFlags,
    offset: u32,
    size: u32,
    values: *const std::ffi::c_void,
) {
    // SAFETY: the caller's arguments.
    unsafe {
        let bytes = std::slice::from_raw_parts(values.cast::<u8>(), size as usize);
        command(commands, "push", (offset, bytes));
        (DeviceState::of(commands).v10.cmd_push_constants)(commands, layout, stages, offset, size, values);
    }
}

pub(crate) unsafe extern "system" fn dispatch(commands: vk::CommandBuffer, x: u32, y: u32, z: u32) {
    command(commands, "dispatch", (x, y, z));
    // SAFETY: the caller's arguments.
    unsafe { (DeviceState::of(commands).v10.cmd_dispatch)(commands, x, y, z) }
}

pub(crate) unsafe extern "system" fn dispatch_indirect(
    commands: vk::CommandBuffer,
    buffer: vk::Buffer,
    offset: vk::DeviceSize,
) {
    command(commands, "dispatch", "indirect");
    // SAFETY: the caller's arguments.
    unsafe { (DeviceState::of(commands).v10.cmd_dispatch_indirect)(commands, buffer, offset) }
}

pub(crate) unsafe extern "system" fn copy_buffer(
    commands: vk::CommandBuffer,
    from: vk::Buffer,
    to: vk::Buffer,
    count: u32,
    regions: *const vk::BufferCopy,
) {
    // SAFETY: the caller's arguments.
    unsafe {
        let sizes: Vec<_> = slice(regions, count).iter().map(|region| region.size).collect();
        command(commands, "copy", sizes);
        (DeviceState::of(commands).v10.cmd_copy_buffer)(commands, from, to, count, regions);
    }
}

pub(crate) unsafe extern "system" fn fill_buffer(
    commands: vk::CommandBuffer,
    buffer: vk::Buffer,
    offset: vk::DeviceSize,
    size: vk::DeviceSize,
    value: u32,
) {
    command(commands, "fill", (size, value));
    // SAFETY: the caller's arguments.
    unsafe { (DeviceState::of(commands).v10.cmd_fill_buffer)(commands, buffer, offset, size, value) }
}

pub(crate) unsafe extern "system" fn update_buffer(
    commands: vk::CommandBuffer,
    buffer: vk::Buffer,
    offset: vk::DeviceSize,
    size: vk::DeviceSize,
    data: *const std::ffi::c_void,
) {
    // SAFETY: the caller's arguments.
    unsafe {
        command(commands, "update", hashed(std::slice::from_raw_parts(data.cast::<u8>(), size as usize)));
        (DeviceState::of(commands).v10.cmd_update_buffer)(commands, buffer, offset, size, data);
    }
}
