//! A host with a guest. The final checks: validation is silent, and nothing of the guest's is left on the device.

use crate::host::{Host, HostOptions, InFlight};
use crate::memory::{HostBuffer, HostTexture, Use};
use ashsplat::ash::{self, vk};
use ashsplat::scene::{Camera, Gaussians, Intrinsics};
use ashsplat::vk::{Context, ContextOptions, ForeignCommands, LimitsOverride, validation_available};
use ashsplat::{Frame, RecordedFrame, RenderSettings, Renderer};
use glam::Vec3;
use std::ffi::{CStr, c_void};
use std::sync::{Mutex, OnceLock, PoisonError};

/// A host with validation if installed.
pub fn options() -> HostOptions {
    let validation = validation_available();
    let required = std::env::var_os("ASHSPLAT_REQUIRE_VALIDATION").is_some();
    assert!(validation || !required, "no Khronos validation layer here; run tools/setup");
    HostOptions { validation, ..HostOptions::default() }
}

/// Runs a test on a host's device. Validation reports every leak when the device is destroyed.
///
/// One host at a time: the layer looks its devices up in a table without a lock ("Occasional crash in
/// GetLayerDataPtr"). A call of one host may crash while another thread creates or destroys a host. This costs no
/// time, because the device uses all processors.
pub fn with_host(options: &HostOptions, test: impl FnOnce(&Host)) {
    static TURN: Mutex<()> = Mutex::new(());
    let _turn = options.validation.then(|| TURN.lock().unwrap_or_else(PoisonError::into_inner));
    let host = Host::new(options).expect("a host");
    test(&host);
    let messages = host.destroy();
    assert!(messages.is_empty(), "validation:\n{}", messages.join("\n"));
}

/// The host's device with another function table. `replace` gets each function's name and address, null if the
/// device has none, and returns the address for the guest.
///
/// # Safety
/// `replace` returns null or a function of that name's type, which may be called wherever the device's own may.
pub unsafe fn device_with(
    host: &Host,
    mut replace: impl FnMut(&CStr, *const c_void) -> *const c_void,
) -> ash::Device {
    let load = |name: &CStr| {
        // SAFETY: the device is alive.
        let own = unsafe { host.instance.get_device_proc_addr(host.device.handle(), name.as_ptr()) };
        replace(name, own.map_or(std::ptr::null(), |own| own as *const c_void))
    };
    // SAFETY: the device is alive; the functions are as the caller promises.
    unsafe { ash::Device::load_with(load, host.device.handle()) }
}

/// The guest's context on a host's device.
pub fn guest(host: &Host) -> Context {
    guest_within(host, None)
}

/// Same as [`guest`], but with bindings of at most 96 KiB.
pub fn guest_of_small_bindings(host: &Host) -> Context {
    guest_within(
        host,
        Some(LimitsOverride { max_storage_buffer_range: Some(96 * 1024), ..LimitsOverride::default() }),
    )
}

fn guest_within(host: &Host, limits_override: Option<LimitsOverride>) -> Context {
    let options = ContextOptions { hazard_check: true, limits_override, ..ContextOptions::default() };
    // SAFETY: the host outlives the context in all tests, which use the queue from one thread. The host lists
    // the enabled features.
    unsafe { Context::from_foreign(&host.foreign(), &options) }.expect("a context")
}

/// A host's command buffer for the guest.
pub fn adopt(context: &Context, frame: &InFlight) -> ForeignCommands {
    // SAFETY: the tests begin it before, record it from one thread, submit it once and wait before it is used again.
    unsafe { context.adopt_commands(frame.commands) }.expect("a command buffer")
}

/// Gaussians in front of the cameras of these tests.
pub fn cloud(count: usize, seed: u32) -> Gaussians {
    let mut state = seed.wrapping_mul(747_796_405).wrapping_add(1);
    let mut random = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as f32 / 16_777_216.0
    };
    let mut cloud = Gaussians { sh_degree: 1, ..Gaussians::default() };
    for _ in 0..count {
        cloud.means.push([2.0 * random() - 1.0, 2.0 * random() - 1.0, 2.0 * random() - 1.0]);
        cloud.quats.push([random() + 0.1, random(), random(), random()]);
        cloud.log_scales.push([0; 3].map(|_| -3.5 + random()));
        cloud.opacity_logits.push(4.0 * random() - 1.0);
        cloud.sh.extend((0..4).map(|k| [0; 3].map(|_| (random() - 0.4) / (1 + k) as f32)));
    }
    cloud
}

/// A camera that looks at the cloud from the side `turn`.
pub fn camera(turn: f32, width: u32, height: u32) -> Camera {
    let eye = Vec3::new(4.0 * turn.sin(), -1.0, -4.0 * turn.cos());
    Camera::look_at(eye, Vec3::ZERO, Vec3::NEG_Y, Intrinsics::from_fov_x(0.7, width, height))
}

/// A device of the engine's without validation, with the kernels of a host's device, because training with texels
/// gives other bits. All tests share it.
pub fn own_device() -> &'static Context {
    static CONTEXT: OnceLock<Context> = OnceLock::new();
    let options = ContextOptions { texels: false, ..ContextOptions::default() };
    CONTEXT.get_or_init(|| Context::new(&options).expect("a device"))
}

/// A frame rendered by a device of the engine's; texels do not change the bits.
pub fn owned(gaussians: &Gaussians, camera: &Camera, settings: &RenderSettings) -> Frame {
    static RENDERER: OnceLock<Mutex<Renderer>> = OnceLock::new();
    let renderer = RENDERER.get_or_init(|| {
        let context = Context::new(&ContextOptions::default()).expect("a device");
        Mutex::new(Renderer::new(&context).expect("kernels"))
    });
    let mut renderer = renderer.lock().unwrap_or_else(PoisonError::into_inner);
    renderer.upload(gaussians).expect("a scene");
    renderer.render(camera, settings).expect("a frame")
}

/// Records, submits and waits for a frame in slot 0. Returns its pixels (r, g, b, transmittance).
pub fn rendered(host: &Host, renderer: &mut Renderer, frame: &RecordedFrame<'_>) -> Vec<[f32; 4]> {
    let in_flight = InFlight::new(host).expect("a command buffer");
    in_flight.begin(host).expect("recording");
    renderer.record(adopt(renderer.context(), &in_flight), 0, frame).expect("a recording");
    let pixels = (frame.camera.width * frame.camera.height) as usize;
    let staging = HostBuffer::new(host, 16 * pixels as u64).expect("memory");
    copy_pixels(host, renderer, 0, &in_flight, &staging, pixels);
    in_flight.submit(host).expect("a submission");
    in_flight.wait(host).expect("done");
    let bytes = staging.read(host, 16 * pixels).expect("bytes");
    staging.destroy(host);
    in_flight.destroy(host);
    bytemuck::pod_collect_to_vec(&bytes)
}

/// Records a copy of a slot's pixels, as a host does, with a wait as the release requires.
pub fn copy_pixels(
    host: &Host,
    renderer: &mut Renderer,
    slot: u32,
    in_flight: &InFlight,
    to: &HostBuffer,
    pixels: usize,
) {
    let (from, offset) = renderer.slot_pixels(slot).expect("a slot").handle();
    let barriers = [vk::MemoryBarrier2::default()
        .src_stage_mask(vk::PipelineStageFlags2::COMPUTE_SHADER)
        .src_access_mask(vk::AccessFlags2::SHADER_STORAGE_WRITE)
        .dst_stage_mask(vk::PipelineStageFlags2::ALL_TRANSFER)
        .dst_access_mask(vk::AccessFlags2::TRANSFER_READ)];
    let dependency = vk::DependencyInfo::default().memory_barriers(&barriers);
    let region = vk::BufferCopy::default().src_offset(offset).size(16 * pixels as u64);
    // SAFETY: recording state; both buffers hold the pixels.
    unsafe {
        host.device.cmd_pipeline_barrier2(in_flight.commands, &dependency);
        host.device.cmd_copy_buffer(in_flight.commands, from, to.raw, &[region]);
    }
    to.to_host(host, in_flight.commands);
}

/// Reads the texels of an image with four bytes each; `from` is its last use.
pub fn read_texture(host: &Host, texture: &HostTexture, from: Use) -> Vec<u8> {
    let bytes = 4 * texture.size[0] as usize * texture.size[1] as usize;
    let staging = HostBuffer::new(host, bytes as u64).expect("memory");
    let copied = host.run(|commands| {
        texture.record_read(host, commands, from, &staging);
        Ok(())
    });
    copied.expect("copied");
    let read = staging.read(host, bytes).expect("bytes");
    staging.destroy(host);
    read
}

/// Fails unless recorded pixels equal a frame's, to the bit.
pub fn assert_same(recorded: &[[f32; 4]], frame: &Frame, background: [f32; 3]) {
    assert_eq!(recorded.len(), frame.color.len());
    for (index, &[r, g, b, t]) in recorded.iter().enumerate() {
        let [x, y, z] = background;
        assert_eq!([r + t * x, g + t * y, b + t * z], frame.color[index], "colour of pixel {index}");
        assert_eq!(t, frame.transmittance[index], "transmittance of pixel {index}");
    }
}

/// Points within a picture of 48 x 36 pixels.
pub fn depth_points() -> Vec<ashsplat::loss::DepthPoint> {
    let point = |k: u32| ashsplat::loss::DepthPoint {
        position_px: [(k * 7 % 47) as f32 + 0.25, (k * 11 % 35) as f32 + 0.5],
        inverse_z: 0.2 + 0.01 * k as f32,
    };
    (0..20).map(point).collect()
}
