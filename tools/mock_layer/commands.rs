//! Commands. Barriers between the machine's families are passed on without them. With `ASHSPLAT_TRACE=FILE`, the commands of every
//! command buffer are written as text, without handles and addresses: two versions of the program record the same commands if these
//! texts agree. `tools/proof` compares them.

use super::state::{Callbacks, DeviceState, passed_on, slice};
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
fn command(commands: vk::CommandBuffer, name: &str, what: impl Debug) {
    if file().is_some() {
        let mut trace = trace();
        let text = trace.recordings.entry(commands.as_raw()).or_default();
        let _ = writeln!(text, "{name} {what:x?}");
    }
}

/// Writes a barrier's masks and layouts, but not its ranges, which differ between runs.
fn traced_barriers(commands: vk::CommandBuffer, info: &vk::DependencyInfo<'_>) {
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

fn hash_of(pipeline: vk::Pipeline) -> Option<u64> {
    trace().pipelines.get(&pipeline.as_raw()).copied()
}

unsafe fn sizes(regions: *const vk::BufferCopy, count: u32) -> Vec<u64> {
    // SAFETY: the caller's array has this size.
    unsafe { slice(regions, count).iter().map(|region| region.size).collect() }
}

unsafe fn bytes<'a>(data: *const c_void, size: impl Into<u64>) -> &'a [u8] {
    // SAFETY: the caller's array has this size.
    unsafe { std::slice::from_raw_parts(data.cast(), size.into() as usize) }
}

/// Ignores transfers between families of the machine; transfers from or to foreign families stay.
fn mapped(from: u32, to: u32) -> (u32, u32) {
    let outside = |family| family >= vk::QUEUE_FAMILY_FOREIGN_EXT;
    if from == to || !(outside(from) || outside(to)) {
        return (vk::QUEUE_FAMILY_IGNORED, vk::QUEUE_FAMILY_IGNORED);
    }
    let real = |family| if outside(family) { family } else { 0 };
    (real(from), real(to))
}

/// Copies barriers, with the driver's families.
macro_rules! remapped {
    ($barriers:expr, $count:expr) => {{
        let barriers = slice($barriers, $count).iter().map(|barrier| {
            let (from, to) = mapped(barrier.src_queue_family_index, barrier.dst_queue_family_index);
            barrier.src_queue_family_index(from).dst_queue_family_index(to)
        });
        barriers.collect::<Vec<_>>()
    }};
}

pub unsafe extern "system" fn barrier(
    commands: vk::CommandBuffer,
    before: vk::PipelineStageFlags,
    after: vk::PipelineStageFlags,
    flags: vk::DependencyFlags,
    memory_count: u32,
    memory: *const vk::MemoryBarrier<'_>,
    buffer_count: u32,
    buffers: *const vk::BufferMemoryBarrier<'_>,
    image_count: u32,
    images: *const vk::ImageMemoryBarrier<'_>,
) {
    // SAFETY: the caller's arguments, passed on with other families.
    unsafe {
        let (buffers, images) = (remapped!(buffers, buffer_count), remapped!(images, image_count));
        let (b, i) = (buffers.as_ptr(), images.as_ptr());
        let next = DeviceState::of(commands).v10.cmd_pipeline_barrier;
        next(commands, before, after, flags, memory_count, memory, buffer_count, b, image_count, i);
    }
}

pub unsafe extern "system" fn barrier2(
    commands: vk::CommandBuffer,
    dependency: *const vk::DependencyInfo<'_>,
) {
    // SAFETY: as above.
    unsafe {
        let info = &*dependency;
        traced_barriers(commands, info);
        let buffers = remapped!(info.p_buffer_memory_barriers, info.buffer_memory_barrier_count);
        let images = remapped!(info.p_image_memory_barriers, info.image_memory_barrier_count);
        let own = info.buffer_memory_barriers(&buffers).image_memory_barriers(&images);
        (DeviceState::of(commands).v13.cmd_pipeline_barrier2)(commands, &raw const own);
    }
}

fn write(commands: vk::CommandBuffer) {
    if let Some(file) = file() {
        let text = trace().recordings.remove(&commands.as_raw()).unwrap_or_default();
        let mut file = file.lock().unwrap_or_else(PoisonError::into_inner);
        let _ = writeln!(file, "{text}end");
    }
}

passed_on! {
    begin(commands: vk::CommandBuffer, info: *const vk::CommandBufferBeginInfo<'_>) -> vk::Result,
        v10.begin_command_buffer, |state| trace().recordings.remove(&commands.as_raw());
    end(commands: vk::CommandBuffer) -> vk::Result,
        v10.end_command_buffer, |state| write(commands);
    bind_pipeline(commands: vk::CommandBuffer, point: vk::PipelineBindPoint, pipeline: vk::Pipeline),
        v10.cmd_bind_pipeline, |state| command(commands, "pipeline", hash_of(pipeline));
    push_constants(
        commands: vk::CommandBuffer, layout: vk::PipelineLayout, stages: vk::ShaderStageFlags, offset: u32, size: u32,
        values: *const c_void),
        v10.cmd_push_constants, |state| command(commands, "push", (offset, bytes(values, size)));
    dispatch(commands: vk::CommandBuffer, x: u32, y: u32, z: u32),
        v10.cmd_dispatch, |state| command(commands, "dispatch", (x, y, z));
    dispatch_indirect(commands: vk::CommandBuffer, buffer: vk::Buffer, offset: u64),
        v10.cmd_dispatch_indirect, |state| command(commands, "dispatch", "indirect");
    copy_buffer(commands: vk::CommandBuffer, from: vk::Buffer, to: vk::Buffer, count: u32, regions: *const vk::BufferCopy),
        v10.cmd_copy_buffer, |state| command(commands, "copy", sizes(regions, count));
    fill_buffer(commands: vk::CommandBuffer, buffer: vk::Buffer, offset: u64, size: u64, value: u32),
        v10.cmd_fill_buffer, |state| command(commands, "fill", (size, value));
    update_buffer(commands: vk::CommandBuffer, buffer: vk::Buffer, offset: u64, size: u64, data: *const c_void),
        v10.cmd_update_buffer, |state| command(commands, "update", hashed(bytes(data, size)));
}
