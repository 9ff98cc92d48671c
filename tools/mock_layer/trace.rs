//! With `ASHSPLAT_TRACE=FILE`, writes the commands of every command buffer as text, without handles and addresses. Two versions
//! of the program record the same commands if these texts agree. `tools/proof` compares them.

use super::loader::{Callbacks, slice};
use super::state::DeviceState;
use ash::vk::{self, Handle};
use std::collections::HashMap;
use std::ffi::c_void;
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
pub fn command(commands: vk::CommandBuffer, name: &str, what: impl Debug) {
    if file().is_some() {
        let mut trace = trace();
        let text = trace.recordings.entry(commands.as_raw()).or_default();
        let _ = writeln!(text, "{name} {what:x?}");
    }
}

/// Writes a barrier's masks and layouts, but not its ranges, which differ between runs.
pub fn barrier(commands: vk::CommandBuffer, info: &vk::DependencyInfo<'_>) {
    // SAFETY: the caller's arrays.
    unsafe {
        for b in slice(info.p_memory_barriers, info.memory_barrier_count) {
            command(
                commands,
                "barrier",
                (b.src_stage_mask, b.src_access_mask, b.dst_stage_mask, b.dst_access_mask),
            );
        }
        for b in slice(info.p_buffer_memory_barriers, info.buffer_memory_barrier_count) {
            let masks = (b.src_stage_mask, b.src_access_mask, b.dst_stage_mask, b.dst_access_mask, b.size);
            command(commands, "buffer barrier", masks);
        }
        for b in slice(info.p_image_memory_barriers, info.image_memory_barrier_count) {
            let masks = (b.src_stage_mask, b.src_access_mask, b.dst_stage_mask, b.dst_access_mask);
            command(commands, "image barrier", (masks, b.old_layout, b.new_layout));
        }
    }
}

pub unsafe extern "system" fn create_shader_module(
    device: vk::Device,
    info: *const vk::ShaderModuleCreateInfo<'_>,
    callbacks: Callbacks<'_>,
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

pub unsafe extern "system" fn create_compute_pipelines(
    device: vk::Device,
    cache: vk::PipelineCache,
    count: u32,
    infos: *const vk::ComputePipelineCreateInfo<'_>,
    callbacks: Callbacks<'_>,
    pipelines: *mut vk::Pipeline,
) -> vk::Result {
    let next = DeviceState::of(device).v10.create_compute_pipelines;
    // SAFETY: the caller's arguments; the pipelines are written by the call.
    unsafe {
        let result = next(device, cache, count, infos, callbacks, pipelines);
        if file().is_some() {
            let made = slice(pipelines, count);
            for (info, pipeline) in slice(infos, count).iter().zip(made) {
                let stage = &info.stage;
                let constants = stage.p_specialization_info.as_ref().map(|info| {
                    let entries = slice(info.p_map_entries, info.map_entry_count);
                    let entries: Vec<_> = entries.iter().map(|e| (e.constant_id, e.offset, e.size)).collect();
                    (entries, bytes(info.p_data, info.data_size as u64).to_vec())
                });
                let mut trace = trace();
                let module = trace.modules.get(&stage.module.as_raw()).copied();
                let hash = hashed((module, constants, stage.flags.as_raw()));
                trace.pipelines.insert(pipeline.as_raw(), hash);
            }
        }
        result
    }
}

pub unsafe extern "system" fn begin(
    commands: vk::CommandBuffer,
    info: *const vk::CommandBufferBeginInfo<'_>,
) -> vk::Result {
    trace().recordings.remove(&commands.as_raw());
    // SAFETY: the caller's arguments.
    unsafe { (DeviceState::of(commands).v10.begin_command_buffer)(commands, info) }
}

pub unsafe extern "system" fn end(commands: vk::CommandBuffer) -> vk::Result {
    if let Some(file) = file() {
        let text = trace().recordings.remove(&commands.as_raw()).unwrap_or_default();
        let mut file = file.lock().unwrap_or_else(PoisonError::into_inner);
        let _ = writeln!(file, "{text}end");
    }
    // SAFETY: the caller's argument.
    unsafe { (DeviceState::of(commands).v10.end_command_buffer)(commands) }
}

fn hash_of(pipeline: vk::Pipeline) -> Option<u64> {
    trace().pipelines.get(&pipeline.as_raw()).copied()
}

unsafe fn bytes<'a>(data: *const c_void, size: impl Into<u64>) -> &'a [u8] {
    // SAFETY: the caller's array has this size.
    unsafe { std::slice::from_raw_parts(data.cast(), size.into() as usize) }
}

/// Defines functions that write a command as text and pass it on. A row has the function's name and its arguments after the command
/// buffer, the driver's function, the text's name, and what is written of the arguments.
macro_rules! traced {
    ($($name:ident($($argument:ident: $kind:ty),*), $next:ident, $text:literal, $written:expr;)*) => {$(
        pub unsafe extern "system" fn $name(commands: vk::CommandBuffer, $($argument: $kind),*) {
            // SAFETY: the caller's arguments.
            unsafe {
                command(commands, $text, $written);
                (DeviceState::of(commands).v10.$next)(commands, $($argument),*)
            }
        }
    )*};
}

traced! {
    bind_pipeline(point: vk::PipelineBindPoint, pipeline: vk::Pipeline),
        cmd_bind_pipeline, "pipeline", hash_of(pipeline);
    push_constants(layout: vk::PipelineLayout, stages: vk::ShaderStageFlags, offset: u32, size: u32, values: *const c_void),
        cmd_push_constants, "push", (offset, bytes(values, size));
    dispatch(x: u32, y: u32, z: u32),
        cmd_dispatch, "dispatch", (x, y, z);
    dispatch_indirect(buffer: vk::Buffer, offset: u64),
        cmd_dispatch_indirect, "dispatch", "indirect";
    copy_buffer(from: vk::Buffer, to: vk::Buffer, count: u32, regions: *const vk::BufferCopy),
        cmd_copy_buffer, "copy", slice(regions, count).iter().map(|region| region.size).collect::<Vec<_>>();
    fill_buffer(buffer: vk::Buffer, offset: u64, size: u64, value: u32),
        cmd_fill_buffer, "fill", (size, value);
    update_buffer(buffer: vk::Buffer, offset: u64, size: u64, data: *const c_void),
        cmd_update_buffer, "update", hashed(bytes(data, size));
}
