//! Heap allocations of recording in C.

#![allow(clippy::disallowed_methods, clippy::expect_used, unsafe_code)]

#[path = "../../../tests/embedding/counting.rs"]
mod counting;

use ashsplat::ash::vk::Handle;
use ashsplat::ash::{self, vk};
use ashsplat_c::*;
use counting::{Counting, allocations};
use std::ffi::{CStr, c_void};
use std::ptr::{null, null_mut};

#[global_allocator]
static COUNTING: Counting = Counting;

fn check(status: AshsplatStatus) {
    // SAFETY: the message ends with a zero, and lives until the next call.
    let said = unsafe { CStr::from_ptr(ashsplat_last_error()) };
    assert!(status == AshsplatStatus::Ok, "{said:?}");
}

/// Vulkan's objects on the device of a context.
struct Host {
    context: *mut AshsplatContext,
    device: ash::Device,
    queue: vk::Queue,
    pool: vk::CommandPool,
    commands: vk::CommandBuffer,
}

impl Host {
    fn new() -> Self {
        let (mut context, mut family) = (null_mut(), 0);
        let [mut instance, mut physical, mut device] = [null_mut(); 3];
        // SAFETY: all pointers are alive; the device lives until the host is closed.
        unsafe {
            let entry = ash::Entry::load().expect("a loader");
            check(ashsplat_context_new(null(), &raw mut context));
            let handles = [&raw mut instance, &raw mut physical, &raw mut device];
            check(ashsplat_context_handles(context, handles[0], handles[1], handles[2], &raw mut family));
            let instance = ash::Instance::load(entry.static_fn(), vk::Instance::from_raw(instance as u64));
            let device = ash::Device::load(instance.fp_v1_0(), vk::Device::from_raw(device as u64));
            let queue = device.get_device_queue(family, 0);
            let info = vk::CommandPoolCreateInfo::default()
                .flags(vk::CommandPoolCreateFlags::RESET_COMMAND_BUFFER)
                .queue_family_index(family);
            let pool = device.create_command_pool(&info, None).expect("a pool");
            let info = vk::CommandBufferAllocateInfo::default().command_pool(pool).command_buffer_count(1);
            let commands = device.allocate_command_buffers(&info).expect("a command buffer")[0];
            Self { context, device, queue, pool, commands }
        }
    }

    /// Number of heap allocations of a recording, which is then submitted and waited for.
    fn recorded(&self, record: impl FnOnce(*mut c_void) -> AshsplatStatus) -> u64 {
        let commands = self.commands;
        let info = vk::CommandBufferBeginInfo::default().flags(vk::CommandBufferUsageFlags::ONE_TIME_SUBMIT);
        // SAFETY: the command buffer is not in use: the queue was waited for.
        unsafe { self.device.begin_command_buffer(commands, &info) }.expect("recording");
        let (taken, status) = allocations(|| record(commands.as_raw() as *mut c_void));
        check(status);
        // SAFETY: recording has ended without errors.
        unsafe {
            self.device.end_command_buffer(commands).expect("recorded");
            let commands = [commands];
            let submits = [vk::SubmitInfo::default().command_buffers(&commands)];
            self.device.queue_submit(self.queue, &submits, vk::Fence::null()).expect("submitted");
            self.device.queue_wait_idle(self.queue).expect("executed");
        }
        taken
    }

    /// A buffer of this many bytes, for a scene's selection.
    fn buffer(&self, bytes: u64) -> (vk::Buffer, vk::DeviceMemory) {
        let usage = vk::BufferUsageFlags::STORAGE_BUFFER
            | vk::BufferUsageFlags::TRANSFER_SRC
            | vk::BufferUsageFlags::TRANSFER_DST;
        let info = vk::BufferCreateInfo::default().size(bytes).usage(usage);
        // SAFETY: valid create infos; the buffer is bound once, to its own memory.
        unsafe {
            let buffer = self.device.create_buffer(&info, None).expect("a buffer");
            let needs = self.device.get_buffer_memory_requirements(buffer);
            let info = vk::MemoryAllocateInfo::default()
                .allocation_size(needs.size)
                .memory_type_index(needs.memory_type_bits.trailing_zeros());
            let memory = self.device.allocate_memory(&info, None).expect("memory");
            self.device.bind_buffer_memory(buffer, memory, 0).expect("bound");
            (buffer, memory)
        }
    }
}

#[test]
fn recording_in_c_takes_nothing_from_the_heap() {
    let host = Host::new();
    let means: Vec<f32> = (0..300).map(|i| (i % 17) as f32 / 8.0 - 1.0).collect();
    let (quats, scales) = ([1.0f32, 0.0, 0.0, 0.0].repeat(100), vec![-3.0f32; 300]);
    let (opacities, sh) = (vec![1.0f32; 100], vec![0.5f32; 300]);
    let cloud = AshsplatGaussians {
        count: 100,
        means: means.as_ptr(),
        quats: quats.as_ptr(),
        log_scales: scales.as_ptr(),
        opacity_logits: opacities.as_ptr(),
        sh: sh.as_ptr(),
        ..AshsplatGaussians::default()
    };
    let (mut scene, mut renderer) = (null_mut(), null_mut());
    let wanted = AshsplatReservation {
        gaussians: 200,
        scenes: 2,
        width: 96,
        height: 64,
        tint: true,
        cut_outs: 2,
        selection: true,
        staging_bytes: 1 << 20,
        ..AshsplatReservation::default()
    };
    // SAFETY: all pointers are alive.
    unsafe {
        check(ashsplat_scene_new(host.context, &raw const cloud, 0, &raw mut scene));
        check(ashsplat_renderer_new(host.context, &raw mut renderer));
        check(ashsplat_reserve(renderer, &raw const wanted));
    }
    let camera = AshsplatCamera {
        translation: [0.0, 0.0, 4.0],
        fx: 96.0,
        fy: 96.0,
        cx: 48.0,
        cy: 32.0,
        width: 96,
        height: 64,
        ..AshsplatCamera::default()
    };
    let cut_outs = [AshsplatCutOut { size: [0.5; 3], ..AshsplatCutOut::default() }; 2];
    let (buffer, memory) = host.buffer(256);
    let mask = AshsplatHostBuffer { buffer: buffer.as_raw(), offset: 0, bytes: 16 };
    let own = AshsplatSceneSettings {
        selection: &raw const mask,
        tint: [0.5, 1.0, 1.0],
        cut_outs: cut_outs.as_ptr(),
        cut_out_count: 2,
        ..AshsplatSceneSettings::default()
    };
    let placed = AshsplatPlaced { scene, ..AshsplatPlaced::default() };
    let scenes = [placed, AshsplatPlaced { settings: &raw const own, ..placed }];
    let few = AshsplatGaussians { count: 30, ..cloud };
    let update = AshsplatUpdate { scene, gaussians: &raw const few, ..AshsplatUpdate::default() };
    // Updates of different sizes.
    let fewer = AshsplatGaussians { count: 7, ..cloud };
    let updates = [update, AshsplatUpdate { first: 40, gaussians: &raw const fewer, ..update }];
    let frame = AshsplatRecordedFrame {
        updates: updates.as_ptr(),
        update_count: 2,
        scenes: scenes.as_ptr(),
        scene_count: 2,
        camera: &raw const camera,
        ..AshsplatRecordedFrame::default()
    };
    let mut release = AshsplatRelease::default();
    let mut taken = Vec::new();
    for _ in 0..5 {
        taken.push(host.recorded(|commands| {
            // SAFETY: all pointers are alive; the slot's last frame has finished.
            unsafe { ashsplat_record(renderer, commands, 0, &raw const frame, &raw mut release) }
        }));
        taken.push(host.recorded(|commands| {
            // SAFETY: as above.
            unsafe { ashsplat_record_views(renderer, commands, 0, &raw const frame, 1, &raw mut release) }
        }));
    }
    assert!(taken[0] > 0, "nothing is counted");
    assert_eq!(taken[4..], [0; 6], "{taken:?}");
    // SAFETY: nothing is in use any more.
    unsafe {
        ashsplat_renderer_free(renderer);
        ashsplat_scene_free(scene);
        host.device.destroy_buffer(buffer, None);
        host.device.free_memory(memory, None);
        host.device.destroy_command_pool(host.pool, None);
        ashsplat_context_free(host.context);
    }
}
