//! A host's queues: one of another family with images that change owners, one that other threads submit to
//! ([`lock`]), and contexts that share device objects.

mod lock;

use crate::child;
use crate::host::AsyncQueue;
use crate::stage::*;
use std::path::Path;

const SIZE: [u32; 2] = [64, 48];

fn asynchronous(host: &Host) -> Context {
    let AsyncQueue { family, queue, .. } = host.async_queue.expect("asked for");
    let foreign = ForeignDevice { queue_family: family, queue: Some(queue), ..host.foreign() };
    let options = ContextOptions { hazard_check: true, ..ContextOptions::default() };
    // SAFETY: as in `guest`, with the other queue.
    unsafe { Context::from_foreign(&foreign, &options) }.expect("a context")
}

/// Runs a trial on a machine with such a family, simulated by the layer of `tools/mock_layer`, under validation.
fn on_a_machine_with_two_queues(trial: &str) {
    let own = Host::new(&HostOptions::default()).expect("a host");
    // SAFETY: a plain query.
    let properties = unsafe { own.instance.get_physical_device_properties(own.physical) };
    let name = properties.device_name_as_c_str().unwrap_or_default().to_string_lossy().into_owned();
    if !cfg!(target_os = "linux") || !name.contains("llvmpipe") {
        eprintln!("skipped: machines are claimed over llvmpipe on Linux only");
        return;
    }
    let binary = std::env::current_exe().expect("a path");
    let mut libraries = vec![binary.parent().expect("deps").to_owned()];
    libraries.extend(std::env::var_os("LD_LIBRARY_PATH").iter().flat_map(std::env::split_paths));
    // The loader stacks layers in the order found. Validation must lie above the mock machine, to see its families.
    let found = ["/usr/local/share", "/usr/share", "/etc"]
        .map(|place| Path::new(place).join("vulkan/explicit_layer.d"));
    let mock = Path::new(env!("CARGO_MANIFEST_DIR")).join("tools/mock_layer");
    let manifests = found.into_iter().chain([mock]);
    child::run(&["--exact", trial], 1, |child| {
        child
            .env("LD_LIBRARY_PATH", std::env::join_paths(&libraries).expect("paths"))
            .env("VK_ADD_LAYER_PATH", std::env::join_paths(manifests).expect("paths"))
            .env("VK_INSTANCE_LAYERS", "VK_LAYER_KHRONOS_validation:VK_LAYER_ASHSPLAT_mock")
            .env("ASHSPLAT_MOCK", "transfer-queue");
    });
}

struct HostSubmission<'a> {
    host: &'a Host,
    queue: vk::Queue,
    pool: vk::CommandPool,
    commands: vk::CommandBuffer,
    done: vk::Semaphore,
}

impl<'a> HostSubmission<'a> {
    fn begin(host: &'a Host, queue: vk::Queue, pool: vk::CommandPool) -> Self {
        let info = vk::CommandBufferAllocateInfo::default()
            .command_pool(pool)
            .level(vk::CommandBufferLevel::PRIMARY)
            .command_buffer_count(1);
        let begin = vk::CommandBufferBeginInfo::default().flags(vk::CommandBufferUsageFlags::ONE_TIME_SUBMIT);
        // SAFETY: valid create infos.
        unsafe {
            let commands = host.device.allocate_command_buffers(&info).expect("a command buffer")[0];
            let done = host.device.create_semaphore(&vk::SemaphoreCreateInfo::default(), None);
            host.device.begin_command_buffer(commands, &begin).expect("recording");
            Self { host, queue, pool, commands, done: done.expect("a semaphore") }
        }
    }

    fn image_barrier(&self, barrier: vk::ImageMemoryBarrier2<'_>) {
        let barriers = [barrier];
        let dependency = vk::DependencyInfo::default().image_memory_barriers(&barriers);
        // SAFETY: recording state.
        unsafe { self.host.device.cmd_pipeline_barrier2(self.commands, &dependency) }
    }

    /// Submits after some other work, and before any work that waits for this.
    fn submit(&self, behind: Option<&HostSubmission<'_>>, signals: bool) {
        let point = |semaphore: vk::Semaphore| {
            let all = vk::PipelineStageFlags2::ALL_COMMANDS;
            vk::SemaphoreSubmitInfo::default().semaphore(semaphore).stage_mask(all)
        };
        let waits: Vec<_> = behind.iter().map(|work| point(work.done)).collect();
        let signals: Vec<_> = signals.then(|| point(self.done)).into_iter().collect();
        let buffers = [vk::CommandBufferSubmitInfo::default().command_buffer(self.commands)];
        let submits = [vk::SubmitInfo2::default()
            .command_buffer_infos(&buffers)
            .wait_semaphore_infos(&waits)
            .signal_semaphore_infos(&signals)];
        // SAFETY: the commands are recorded, and the objects that they use live until the host has waited.
        unsafe {
            self.host.device.end_command_buffer(self.commands).expect("recorded");
            self.host.device.queue_submit2(self.queue, &submits, vk::Fence::null()).expect("submitted");
        }
    }
}

impl Drop for HostSubmission<'_> {
    fn drop(&mut self) {
        if std::thread::panicking() {
            return;
        }
        // SAFETY: the host has waited.
        unsafe {
            self.host.device.destroy_semaphore(self.done, None);
            self.host.device.free_command_buffers(self.pool, &[self.commands]);
        }
    }
}

/// Uses before a recording. A compute queue has no fragment stage, and discarded contents need no ownership
/// transfer.
fn uses() -> [ImageState; 4] {
    let fragments = vk::PipelineStageFlags2::FRAGMENT_SHADER;
    let drawn = ImageState { stages: COPIED.stages | fragments, ..COPIED };
    [COPIED, drawn, ImageState::UNDEFINED, ImageState { stages: fragments, ..ImageState::UNDEFINED }]
}

/// Draws frames of the guest's queue over the host's picture, or over a colour if that is discarded, and returns the
/// image to the host.
fn draw_in_turns(
    host: &Host,
    context: &Context,
    of_guest: (vk::Queue, vk::CommandPool),
    (image, texture): (&Image, &Texture<'_>),
) {
    let gaussians = cloud(300, 3);
    let scene = uploaded(context, &gaussians);
    let wanted = Reservation { views: 2, images_only: true, ..Reservation::new(300, 1, SIZE[0], SIZE[1]) };
    let mut renderer = reserved(context, &wanted);
    let placed = [Placed::from(&scene)];
    let staging = texture.staging();
    let mut last = ImageState::UNDEFINED;
    for (frame, from) in uses().into_iter().enumerate() {
        let grey = 0.25 * (frame + 1) as f32;
        let keeps = from.layout != vk::ImageLayout::UNDEFINED;
        let whole = camera(0.3 * frame as f32, SIZE[0], SIZE[1]);
        let inset = camera(1.0, 16, 16);
        let before = HostSubmission::begin(host, host.queue, host.pool);
        texture.clear(before.commands, last, [grey, grey, grey, 1.0]);
        if keeps {
            before.image_barrier(image.hand_over(from));
        }
        let guests = HostSubmission::begin(host, of_guest.0, of_guest.1);
        let target = |offset| Target::Image {
            to: HostImage { image, from, offset },
            behind: if keeps { Background::Image } else { Background::Color([grey; 3]) },
            encoding: ColorEncoding::AsTrained,
        };
        let views = [
            RecordedFrame { target: target([0; 2]), ..frame_of(&placed, &whole) },
            RecordedFrame { target: target([48, 32]), ..frame_of(&placed, &inset) },
        ];
        // SAFETY: it is being recorded, is submitted once and waited for.
        let commands = unsafe { context.adopt_commands(guests.commands) }.expect("a command buffer");
        let mut releases = [Release::default(); 2];
        renderer.record_views(commands, 0, &views, &mut releases).expect("a recording");
        let release = releases[1].color.expect("a target");
        assert_eq!((releases[0].color, release.layout), (Some(release), image.layout()));
        let behind = HostSubmission::begin(host, host.queue, host.pool);
        behind.image_barrier(image.take_back());
        texture.record_read(host, behind.commands, used(release), &staging);
        last = READ;
        before.submit(None, true);
        guests.submit(Some(&before), true);
        behind.submit(Some(&guests), false);
        host.wait().expect("done");
        let texels: Vec<[f32; 4]> = staging.read();
        let [below, above] = [whole, inset].map(|camera| owned(&gaussians, &camera, &SETTINGS));
        for (i, texel) in texels.iter().enumerate() {
            let [x, y] = [i % SIZE[0] as usize, i / SIZE[0] as usize];
            let mut expected = below.color[i].map(|c| c + below.transmittance[i] * grey);
            if x >= 48 && y >= 32 {
                let at = (y - 32) * 16 + x - 48;
                let behind = if keeps { expected } else { [grey; 3] };
                expected = [0, 1, 2].map(|c| above.color[at][c] + above.transmittance[at] * behind[c]);
            }
            let near = (0..3).all(|c| (texel[c] - expected[c]).abs() < 1e-6);
            assert!(near, "frame {frame}, ({x}, {y}): {texel:?}, not {expected:?}");
        }
    }
    drop(renderer);
}

fn shared_image<'a>(host: &'a Host, context: &Context) -> Picture<'a> {
    let target = ("shared", ImageUse::Target);
    Picture::new(host, context, target, vk::Format::R32G32B32A32_SFLOAT, SIZE)
}

fn assert_one_owner(
    host: &Host,
    context: &Context,
    of_guest: (vk::Queue, vk::CommandPool),
    images: [&Image; 2],
) {
    let scene = uploaded(context, &cloud(300, 3));
    let (placed, eye) = ([Placed::from(&scene)], camera(0.3, SIZE[0], SIZE[1]));
    let wanted = Reservation { views: 2, images_only: true, ..Reservation::new(300, 1, SIZE[0], SIZE[1]) };
    let mut renderer = reserved(context, &wanted);
    let views = images.map(|image| RecordedFrame {
        target: Target::Image {
            to: HostImage { image, from: ImageState::UNDEFINED, offset: [0; 2] },
            behind: Background::Color([0.0; 3]),
            encoding: ColorEncoding::AsTrained,
        },
        ..frame_of(&placed, &eye)
    });
    let work = HostSubmission::begin(host, of_guest.0, of_guest.1);
    // SAFETY: it is being recorded, and thrown away.
    let commands = unsafe { context.adopt_commands(work.commands) }.expect("a command buffer");
    let refused = renderer.record_views(commands, 0, &views, &mut [Release::default(); 2]);
    let error = refused.expect_err("two owners").to_string();
    let wanted = "views[1].target (image 'shared'): is also views[0].target: they say that other queue families own it";
    assert!(error.contains(wanted), "{error}");
    drop(renderer);
}

/// Frames of a compute queue over the graphics queue's picture, and back to that queue.
#[test]
#[ignore = "the child's part of images_change_hands_between_queues"]
fn images_change_hands_in_a_child() {
    with_host(&HostOptions { async_compute: true, ..options() }, |host| {
        let context = asynchronous(host);
        let apart = host.async_queue.expect("asked for");
        assert_ne!(apart.family, host.queue_family);
        let scene = uploaded(&context, &cloud(300, 3));
        // A scene that the other family owns cannot be drawn here.
        let other = guest(host);
        assert_error(
            scene.in_context(&other),
            "scene: queue family 2 owns it, the context's queues are of family 0",
        );
        drop(other);
        let Picture { image, texture } = shared_image(host, &context);
        assert_error(image.clone().of_family(3), "image 'shared': queue family 3, the device has 3");
        let owned = image.clone().of_family(host.queue_family).expect("a family");
        let of_guest = (apart.queue, apart.pool);
        assert_one_owner(host, &context, of_guest, [&image, &owned]);
        assert_one_owner(host, &context, of_guest, [&owned, &image]);
        draw_in_turns(host, &context, of_guest, (&owned, &texture));
        drop((scene, owned, image));
    });
}

/// If the context's own family owns an image, both of the host's barriers are plain ones.
#[test]
fn barriers_fit_images_of_the_own_family() {
    with_guest(|host, context| {
        let Picture { image, texture } = shared_image(host, &context);
        let named = image.clone().of_family(host.queue_family).expect("a family");
        for image in [&image, &named] {
            let (there, back) = (image.hand_over(COPIED), image.take_back());
            assert_eq!([there.old_layout, there.new_layout], [COPIED.layout; 2]);
            assert_eq!([back.old_layout, back.new_layout], [image.layout(); 2]);
            assert_eq!(back.src_access_mask, vk::AccessFlags2::SHADER_STORAGE_WRITE);
        }
        draw_in_turns(host, &context, (host.queue, host.pool), (&named, &texture));
        drop((named, image));
    });
}

#[test]
fn images_change_hands_between_queues() {
    on_a_machine_with_two_queues("queues::images_change_hands_in_a_child");
}

/// Two contexts on one device draw a scene that one has uploaded. The scene outlives the first context.
#[test]
fn contexts_of_a_device_share_scenes() {
    with_host(&options(), |host| {
        let (first, second) = (guest(host), guest(host));
        let gaussians = cloud(300, 3);
        let view = camera(0.3, SIZE[0], SIZE[1]);
        let scene = uploaded(&first, &gaussians);
        let mut renderer = reserved(&second, &Reservation::new(300, 1, SIZE[0], SIZE[1]));
        assert_error(
            renderer.render_scene(&scene, &view, &SETTINGS),
            "another context: on the same VkDevice, DeviceScene::in_context",
        );
        let shared = scene.in_context(&second).expect("the same family");
        let held = first.memory_total().bytes;
        drop(scene);
        let expected = owned(&gaussians, &view, &SETTINGS);
        let placed = [Placed::from(&shared)];
        let frame = frame_of(&placed, &view);
        assert_same(&rendered(host, &mut renderer, &frame), &expected);
        let own = renderer.render_scene(&shared, &view, &SETTINGS).expect("a frame");
        assert!(own.color == expected.color);
        assert_eq!(first.memory_total().bytes, held, "the other context keeps it");
        drop((renderer, shared));
        assert!(first.memory_total().bytes < held, "nobody keeps it any more");

        let scene = uploaded(&first, &gaussians);
        let small = guest_of(&host.foreign(), &small_bindings(16 * 1024));
        assert_error(scene.in_context(&small), "scene: the limits of the context ask for another plan");
        assert_error(scene.in_context(own_device()), "scene: it belongs to another device");
    });
}
