//! A host with a guest. The final checks: validation is silent, and nothing of the guest's is left on the device.
//!
//! Tests import all of this module, which includes the names of host and guest that most of them use.

pub use crate::host::{Host, HostOptions, InFlight};
pub use crate::memory::{HostBuffer, HostTexture, Use};
pub use ashsplat::ash::{self, vk};
pub use ashsplat::scene::{Camera, CutOut, DepthMapping, Gaussians, Inside, Intrinsics, Pose, Volume};
pub use ashsplat::vk::{
    Buffer, Context, ContextOptions, ForeignCommands, ForeignDevice, Image, ImageState, ImageUse,
    LimitsOverride, MemoryKind,
};
pub use ashsplat::{
    Background, Blending, ColorEncoding, DepthTarget, DeviceScene, Error, Frame, HostImage, MotionTarget,
    Occluder, Placed, RecordedFrame, Release, RenderSettings, Renderer, Reservation, SceneSettings,
    Selection, ShStorage, SlotReport, Target, TrainSettings, Update,
};
pub use glam::{Mat3, Quat, Vec3};
pub use std::ffi::{CStr, c_void};

use ashsplat::train::StepReservation;
use ashsplat::vk::validation_available;
use std::ops::Deref;
use std::sync::{LazyLock, Mutex, OnceLock, PoisonError};

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

pub fn with_guest(test: impl FnOnce(&Host, Context)) {
    with_host(&options(), |host| test(host, guest(host)));
}

/// Same as [`with_guest`], once with push descriptors and once without.
pub fn with_each_guest(test: impl Fn(&Host, Context)) {
    for push_descriptors in [true, false] {
        with_host(&HostOptions { push_descriptors, ..options() }, |host| test(host, guest(host)));
    }
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

/// Wrappers of a device's functions. Each tells `$note` its name, runs the block, which may return, and calls the device's
/// own. Defines `wrapped`, which has the wrapper of a name and stores the own address.
macro_rules! wrappers {
    ($note:path; $($name:literal $wrapper:ident($($arg:ident: $ty:ty),*) -> $ret:ty $(, $first:block)?;)*) => {
        mod real {
            use std::sync::atomic::AtomicUsize;
            $(#[allow(non_upper_case_globals)] pub static $wrapper: AtomicUsize = AtomicUsize::new(0);)*
        }
        $(unsafe extern "system" fn $wrapper($($arg: $ty),*) -> $ret {
            $note($name);
            $($first)?
            // SAFETY: the address is that of the device's function of this type.
            unsafe {
                let own = real::$wrapper.load(std::sync::atomic::Ordering::SeqCst);
                let own: unsafe extern "system" fn($($ty),*) -> $ret = std::mem::transmute(own);
                own($($arg),*)
            }
        })*
        fn wrapped(name: &CStr, own: *const c_void) -> Option<*const c_void> {
            match name.to_str().expect("a name") {
                $($name => {
                    real::$wrapper.store(own as usize, std::sync::atomic::Ordering::SeqCst);
                    Some($wrapper as *const c_void)
                })*
                _ => None,
            }
        }
    };
}
pub(crate) use wrappers;

pub fn guest(host: &Host) -> Context {
    guest_of(&host.foreign(), &ContextOptions { hazard_check: true, ..ContextOptions::default() })
}

/// Same as [`guest`], but with bindings of at most 96 KiB.
pub fn guest_of_small_bindings(host: &Host) -> Context {
    let options = ContextOptions { hazard_check: true, ..small_bindings(96 * 1024) };
    guest_of(&host.foreign(), &options)
}

pub fn small_bindings(bytes: u64) -> ContextOptions {
    let limits = LimitsOverride { max_storage_buffer_range: Some(bytes), ..LimitsOverride::default() };
    ContextOptions { limits_override: Some(limits), ..ContextOptions::default() }
}

pub fn guest_of(foreign: &ForeignDevice<'_>, options: &ContextOptions) -> Context {
    // SAFETY: the host outlives the context in all tests. They use the queue from one thread, or under its lock. The
    // host lists the enabled features.
    unsafe { Context::from_foreign(foreign, options) }.expect("a context")
}

/// A host's object that is destroyed when it is dropped. A failed test leaves it, because the device may use it.
pub struct Own<'a, T> {
    pub host: &'a Host,
    object: Option<T>,
    destroy: fn(T, &Host),
}

impl<'a, T> Own<'a, T> {
    pub fn of(host: &'a Host, object: T, destroy: fn(T, &Host)) -> Self {
        Self { host, object: Some(object), destroy }
    }
}

impl<T> Deref for Own<'_, T> {
    type Target = T;

    fn deref(&self) -> &T {
        self.object.as_ref().expect("it is there until dropped")
    }
}

impl<T> Drop for Own<'_, T> {
    fn drop(&mut self) {
        if let Some(object) = self.object.take().filter(|_| !std::thread::panicking()) {
            (self.destroy)(object, self.host);
        }
    }
}

pub type Commands<'a> = Own<'a, InFlight>;

impl<'a> Own<'a, InFlight> {
    pub fn new(host: &'a Host) -> Self {
        Self::of(host, InFlight::new(host).expect("a command buffer"), InFlight::destroy)
    }

    pub fn begin(&self) {
        InFlight::begin(self, self.host).expect("recording");
    }

    /// The command buffer, for the guest. The host has begun it.
    pub fn adopt(&self, context: &Context) -> ForeignCommands {
        // SAFETY: the tests record it from one thread, submit it once and wait before it is used again.
        unsafe { context.adopt_commands(self.commands) }.expect("a command buffer")
    }

    pub fn begun(&self, context: &Context) -> ForeignCommands {
        self.begin();
        self.adopt(context)
    }

    pub fn submit(&self) {
        InFlight::submit(self, self.host).expect("a submission");
    }

    pub fn wait(&self) {
        InFlight::wait(self, self.host).expect("done");
    }

    pub fn finish(&self) {
        self.submit();
        self.wait();
    }
}

/// An event that the device waits for.
pub struct Gate<'a>(Own<'a, vk::Event>);

impl<'a> Gate<'a> {
    pub fn closed(host: &'a Host) -> Self {
        // SAFETY: a valid create info.
        let event = unsafe { host.device.create_event(&vk::EventCreateInfo::default(), None) };
        // SAFETY: nothing waits for it any more when it is dropped.
        let destroy = |event, host: &Host| unsafe { host.device.destroy_event(event, None) };
        Self(Own::of(host, event.expect("an event"), destroy))
    }

    /// All later commands wait until the gate is open.
    pub fn record_wait(&self, commands: vk::CommandBuffer) {
        let (from, to) = (vk::PipelineStageFlags::HOST, vk::PipelineStageFlags::ALL_COMMANDS);
        // SAFETY: recording state; the event lives until the submission is over.
        unsafe { self.0.host.device.cmd_wait_events(commands, &[*self.0], from, to, &[], &[], &[]) }
    }

    pub fn open(&self) {
        // SAFETY: the event is alive.
        unsafe { self.0.host.device.set_event(*self.0) }.expect("set");
    }
}

pub struct Staging<'a> {
    buffer: Own<'a, HostBuffer>,
    bytes: u64,
}

impl<'a> Staging<'a> {
    pub fn new(host: &'a Host, bytes: u64) -> Self {
        Self {
            buffer: Own::of(host, HostBuffer::new(host, bytes).expect("memory"), HostBuffer::destroy),
            bytes,
        }
    }

    pub fn holding(host: &'a Host, bytes: &[u8]) -> Self {
        let staging = Self::new(host, bytes.len() as u64);
        staging.write(bytes);
        staging
    }

    pub fn write(&self, bytes: &[u8]) {
        self.buffer.write(self.buffer.host, bytes).expect("written");
    }

    pub fn read<T: bytemuck::Pod>(&self) -> Vec<T> {
        let read = self.buffer.read(self.buffer.host, self.bytes as usize);
        bytemuck::pod_collect_to_vec(&read.expect("bytes"))
    }

    pub fn adopt(&self, context: &Context, name: &'static str, offset: u64, bytes: u64) -> Buffer {
        // SAFETY: the buffer is the host's, of this size, and outlives what the guest makes of it. Uses of overlapping
        // ranges are apart in time.
        unsafe { Buffer::adopt(context, name, self.raw, offset, bytes) }.expect("adopted")
    }
}

impl Deref for Staging<'_> {
    type Target = HostBuffer;

    fn deref(&self) -> &HostBuffer {
        &self.buffer
    }
}

/// State of an image that kernels have written.
pub const WRITTEN: ImageState = ImageState {
    layout: vk::ImageLayout::GENERAL,
    stages: vk::PipelineStageFlags2::COMPUTE_SHADER,
    accesses: vk::AccessFlags2::SHADER_STORAGE_WRITE,
};
/// State of an image that the host has cleared or copied to.
pub const COPIED: ImageState = ImageState {
    layout: vk::ImageLayout::TRANSFER_DST_OPTIMAL,
    stages: vk::PipelineStageFlags2::ALL_TRANSFER,
    accesses: vk::AccessFlags2::TRANSFER_WRITE,
};
/// State of an image that the host has read.
pub const READ: ImageState = ImageState {
    layout: vk::ImageLayout::TRANSFER_SRC_OPTIMAL,
    stages: vk::PipelineStageFlags2::ALL_TRANSFER,
    accesses: vk::AccessFlags2::NONE,
};

pub fn used(ImageState { layout, stages, accesses }: ImageState) -> Use {
    (layout, stages, accesses)
}

pub fn texel_bytes(format: vk::Format) -> u32 {
    match format {
        vk::Format::R16G16B16A16_SFLOAT => 8,
        vk::Format::R32G32B32A32_SFLOAT | vk::Format::R32G32B32A32_UINT => 16,
        _ => 4,
    }
}

pub type Texture<'a> = Own<'a, HostTexture>;

impl<'a> Own<'a, HostTexture> {
    pub fn new(host: &'a Host, format: vk::Format, usage: vk::ImageUsageFlags, size: [u32; 2]) -> Self {
        Self::of(host, HostTexture::new(host, format, usage, size).expect("an image"), HostTexture::destroy)
    }

    pub fn adopt(&self, context: &Context, name: &'static str, purpose: ImageUse) -> Image {
        // SAFETY: the description matches the image, which outlives every use of the view.
        unsafe { Image::adopt(context, name, &self.foreign(), purpose) }.expect("adopted")
    }

    pub fn staging(&self) -> Staging<'a> {
        Staging::new(self.host, u64::from(texel_bytes(self.format) * self.size[0] * self.size[1]))
    }

    pub fn read<T: bytemuck::Pod>(&self, from: ImageState) -> Vec<T> {
        let staging = self.staging();
        let copied = self.host.run(|commands| {
            self.record_read(self.host, commands, used(from), &staging);
            Ok(())
        });
        copied.expect("copied");
        staging.read()
    }

    pub fn write<T: bytemuck::Pod>(&self, texels: &[T]) {
        let staging = Staging::holding(self.host, bytemuck::cast_slice(texels));
        let copied = self.host.run(|commands| {
            self.barrier(self.host, commands, used(ImageState::UNDEFINED), used(COPIED));
            let (device, regions) = (&self.host.device, [self.region()]);
            // SAFETY: recording state; the staging buffer holds the whole image.
            unsafe {
                device.cmd_copy_buffer_to_image(commands, staging.raw, self.image, COPIED.layout, &regions);
            }
            Ok(())
        });
        copied.expect("copied");
    }

    pub fn clear(&self, commands: vk::CommandBuffer, from: ImageState, float32: [f32; 4]) {
        self.barrier(self.host, commands, used(from), used(COPIED));
        let (device, color) = (&self.host.device, vk::ClearColorValue { float32 });
        // SAFETY: recording state; the image has TRANSFER_DST and this layout.
        unsafe {
            device.cmd_clear_color_image(commands, self.image, COPIED.layout, &color, &[whole(self.aspect)]);
        }
    }
}

pub fn whole(aspect_mask: vk::ImageAspectFlags) -> vk::ImageSubresourceRange {
    vk::ImageSubresourceRange { aspect_mask, level_count: 1, layer_count: 1, ..Default::default() }
}

pub fn host_image(image: &Image, from: ImageState) -> HostImage<'_> {
    HostImage { image, from, offset: [0; 2] }
}

pub struct Picture<'a> {
    // Dropped before the image that it views.
    pub image: Image,
    pub texture: Texture<'a>,
}

impl<'a> Picture<'a> {
    pub fn new(
        host: &'a Host,
        context: &Context,
        (name, purpose): (&'static str, ImageUse),
        format: vk::Format,
        size: [u32; 2],
    ) -> Self {
        let copies = vk::ImageUsageFlags::TRANSFER_SRC | vk::ImageUsageFlags::TRANSFER_DST;
        let usage = match purpose {
            ImageUse::Occluder => vk::ImageUsageFlags::SAMPLED | copies,
            ImageUse::Target => vk::ImageUsageFlags::STORAGE | vk::ImageUsageFlags::COLOR_ATTACHMENT | copies,
            _ => vk::ImageUsageFlags::STORAGE | copies,
        };
        let texture = Texture::new(host, format, usage, size);
        Self { image: texture.adopt(context, name, purpose), texture }
    }

    pub fn of_depth(host: &'a Host, context: &Context, size: [u32; 2], value: f32) -> Self {
        let depth = Self::new(host, context, ("depth", ImageUse::Occluder), vk::Format::D32_SFLOAT, size);
        depth.texture.write(&vec![value; (size[0] * size[1]) as usize]);
        depth
    }

    /// The image, for a frame that discards its contents.
    pub fn unused(&self) -> HostImage<'_> {
        host_image(&self.image, ImageState::UNDEFINED)
    }
}

pub fn into(image: &Image, behind: Background, offset: [u32; 2]) -> Target<'_> {
    let to = HostImage { offset, ..host_image(image, ImageState::UNDEFINED) };
    Target::Image { to, behind, encoding: ColorEncoding::AsTrained }
}

pub fn uploaded(context: &Context, gaussians: &Gaussians) -> DeviceScene {
    DeviceScene::upload(context, gaussians, 0).expect("a scene")
}

pub fn mask_of(context: &Context, bytes: &[u8]) -> Buffer {
    let request = [("mask", bytes.len() as u64)];
    let mask = context.allocate("selection", &request, MemoryKind::Device).expect("memory");
    context.upload(&mask[0], bytes).expect("uploaded");
    mask[0].clone()
}

pub fn reserved(context: &Context, wanted: &Reservation) -> Renderer {
    let mut renderer = Renderer::new(context).expect("kernels");
    renderer.reserve(wanted).expect("memory");
    renderer
}

/// Settings of frames unless a test is about them.
pub static SETTINGS: LazyLock<RenderSettings> = LazyLock::new(RenderSettings::default);

/// Recorded training with one step in flight.
pub const ONE_SLOT: StepReservation = StepReservation { slots: 1, instances: 0, visible: 0 };

pub fn frame_of<'a>(scenes: &'a [Placed<'a>], camera: &'a Camera) -> RecordedFrame<'a> {
    RecordedFrame::new(scenes, camera, &SETTINGS)
}

pub fn report_of(renderer: &mut Renderer, slot: u32) -> SlotReport {
    renderer.slot_report(slot).expect("a report").expect("finished")
}

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
    let commands = Commands::new(host);
    let staging = Staging::new(host, 16 * u64::from(frame.camera.width * frame.camera.height));
    renderer.record(commands.begun(renderer.context()), 0, frame).expect("a recording");
    copy_pixels(renderer, 0, &commands, &staging);
    commands.finish();
    staging.read()
}

/// Renders as [`rendered`]. Fails unless the picture is the engine's own of these Gaussians, to the bit.
pub fn assert_drawn(host: &Host, renderer: &mut Renderer, frame: &RecordedFrame<'_>, gaussians: &Gaussians) {
    assert_same(&rendered(host, renderer, frame), &owned(gaussians, frame.camera, frame.settings));
}

pub fn render_views(host: &Host, renderer: &mut Renderer, views: &[RecordedFrame<'_>]) -> Vec<Release> {
    let commands = Commands::new(host);
    let mut releases = vec![Release::default(); views.len()];
    let adopted = commands.begun(renderer.context());
    renderer.record_views(adopted, 0, views, &mut releases).expect("a recording");
    commands.finish();
    releases
}

pub fn refused(host: &Host, renderer: &mut Renderer, frame: &RecordedFrame<'_>) -> Error {
    let commands = Commands::new(host);
    renderer.record(commands.begun(renderer.context()), 0, frame).expect_err("refused")
}

pub fn assert_error<T>(result: Result<T, Error>, expected: &str) {
    match result {
        Ok(_) => panic!("accepted (expected {expected})"),
        Err(error) => assert!(error.to_string().contains(expected), "{error} (expected {expected})"),
    }
}

pub fn assert_argument(error: &Error, expected: &str) {
    assert!(matches!(error, Error::Argument { .. }), "{error:?}");
    assert!(error.to_string().contains(expected), "{error} (expected {expected})");
}

pub fn copy_pixels(renderer: &mut Renderer, slot: u32, commands: &Commands<'_>, to: &Staging<'_>) {
    let (from, offset) = renderer.slot_pixels(slot).expect("a slot").handle();
    let barriers = [vk::MemoryBarrier2::default()
        .src_stage_mask(vk::PipelineStageFlags2::COMPUTE_SHADER)
        .src_access_mask(vk::AccessFlags2::SHADER_STORAGE_WRITE)
        .dst_stage_mask(vk::PipelineStageFlags2::ALL_TRANSFER)
        .dst_access_mask(vk::AccessFlags2::TRANSFER_READ)];
    let dependency = vk::DependencyInfo::default().memory_barriers(&barriers);
    let region = vk::BufferCopy::default().src_offset(offset).size(to.bytes);
    let device = &commands.host.device;
    // SAFETY: recording state; both buffers hold the pixels.
    unsafe {
        device.cmd_pipeline_barrier2(commands.commands, &dependency);
        device.cmd_copy_buffer(commands.commands, from, to.raw, &[region]);
    }
    to.to_host(commands.host, commands.commands);
}

/// Fails unless recorded pixels equal a frame's over black, to the bit.
pub fn assert_same(recorded: &[[f32; 4]], frame: &Frame) {
    assert_eq!(recorded.len(), frame.color.len());
    for (index, &[r, g, b, t]) in recorded.iter().enumerate() {
        assert_eq!([r, g, b], frame.color[index], "colour of pixel {index}");
        assert_eq!(t, frame.transmittance[index], "transmittance of pixel {index}");
    }
}

pub fn depth_points() -> Vec<ashsplat::passes::loss::DepthPoint> {
    let point = |k: u32| ashsplat::passes::loss::DepthPoint {
        position_px: [(k * 7 % 47) as f32 + 0.25, (k * 11 % 35) as f32 + 0.5],
        inverse_z: 0.2 + 0.01 * k as f32,
    };
    (0..20).map(point).collect()
}
