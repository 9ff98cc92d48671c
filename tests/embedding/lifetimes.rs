//! How long a slot keeps the objects of its recording, and the fate of recordings that are not executed.

use crate::host::{Host, HostOptions, InFlight};
use crate::memory::{HostBuffer, HostTexture};
use crate::stage::{adopt, assert_same, camera, cloud, guest, options, owned, rendered, with_host};
use ashsplat::ash::{vk, vk::Handle};
use ashsplat::kernels::arithmetic::multiply_add;
use ashsplat::vk::{
    Buffer, Context, ContextOptions, Image, ImageState, ImageUse, Kernel, KernelInterface, MemoryKind,
    RecordSlot,
};
use ashsplat::{
    Background, Camera, ColorEncoding, DeviceScene, HostImage, Placed, RecordedFrame, RenderSettings,
    Renderer, Reservation, Target,
};

fn renderer(context: &Context, slots: u32) -> Renderer {
    let mut renderer = Renderer::new(context).expect("kernels");
    let reservation =
        Reservation { slots, inverse_depth: true, scenes: 2, ..Reservation::new(1600, 1, 64, 48) };
    renderer.reserve(&reservation).expect("memory");
    renderer
}

fn scene_bytes(context: &Context) -> u64 {
    context.memory().iter().find(|arena| arena.name == "scene").map_or(0, |arena| arena.bytes)
}

/// Scenes and views that are dropped while two slots' frames use them live until both are done.
#[test]
fn what_is_dropped_lives_as_long_as_its_slots_need_it() {
    with_host(&options(), |host| {
        let context = guest(host);
        let mut renderer = renderer(&context, 2);
        let (gaussians, view) = (cloud(300, 1), camera(0.3, 64, 48));
        let scene = DeviceScene::upload(&context, &gaussians, 0).expect("a scene");
        let bytes = scene_bytes(&context);
        let usage = vk::ImageUsageFlags::STORAGE;
        let texture = HostTexture::new(host, vk::Format::R8G8B8A8_UNORM, usage, [64, 48]).expect("an image");
        // SAFETY: the description matches the image, which is destroyed after both slots have let go of the view.
        let image = unsafe { Image::adopt(&context, "target", &texture.foreign(), ImageUse::Target) };
        let image = image.expect("adopted");
        let frames = [0; 2].map(|_| InFlight::new(host).expect("a command buffer"));
        let settings = RenderSettings::default();
        let placed = [Placed::from(&scene)];
        for (slot, frame) in (0..).zip(&frames) {
            frame.begin(host).expect("recording");
            let from = match slot {
                0 => ImageState::UNDEFINED,
                _ => ImageState {
                    layout: vk::ImageLayout::GENERAL,
                    stages: vk::PipelineStageFlags2::COMPUTE_SHADER,
                    accesses: vk::AccessFlags2::SHADER_STORAGE_WRITE,
                },
            };
            let to = HostImage { image: &image, from, offset: [0; 2] };
            let target =
                Target::Image { to, behind: Background::Nothing, encoding: ColorEncoding::AsTrained };
            let recorded = RecordedFrame { target, ..RecordedFrame::new(&placed, &view, &settings) };
            renderer.record(adopt(&context, frame), slot, &recorded).expect("a recording");
            let error = renderer.release_slot(slot).expect_err("in flight");
            assert!(error.to_string().contains("in flight"), "{error}");
            frame.submit(host).expect("a submission");
        }
        drop((scene, image));
        assert_eq!(scene_bytes(&context), bytes);
        frames[0].wait(host).expect("done");
        renderer.release_slot(0).expect("over");
        assert_eq!(scene_bytes(&context), bytes, "the other frame may still use it");
        frames[1].wait(host).expect("done");
        // The slot's next recording releases the scene, too.
        let other = DeviceScene::empty(&context, 1, 0).expect("a scene");
        let others = [Placed::from(&other)];
        frames[1].begin(host).expect("recording");
        let recorded = RecordedFrame::new(&others, &view, &settings);
        renderer.record(adopt(&context, &frames[1]), 1, &recorded).expect("a recording");
        frames[1].submit(host).expect("a submission");
        frames[1].wait(host).expect("done");
        assert!(scene_bytes(&context) < bytes, "it has no user any more");
        texture.destroy(host);
        frames.into_iter().for_each(|frame| frame.destroy(host));
    });
}

/// The guest's own commands finish before later commands of the host.
#[test]
fn a_report_does_not_wait_for_the_hosts_own_commands() {
    with_host(&options(), |host| {
        // On llvmpipe, a query of timestamps waits for the whole device.
        let without_times =
            ContextOptions { timestamps: false, hazard_check: true, ..ContextOptions::default() };
        // SAFETY: as in `guest`.
        let context = unsafe { Context::from_foreign(&host.foreign(), &without_times) }.expect("a context");
        let mut renderer = renderer(&context, 1);
        let scene = DeviceScene::upload(&context, &cloud(300, 1), 0).expect("a scene");
        let (settings, view, placed) = (RenderSettings::default(), camera(0.3, 64, 48), [(&scene).into()]);
        let frame = InFlight::new(host).expect("a command buffer");
        // SAFETY: valid create infos; the event is set below, so that the device goes on.
        let gate = unsafe { host.device.create_event(&vk::EventCreateInfo::default(), None) };
        let gate = gate.expect("an event");
        frame.begin(host).expect("recording");
        let recorded = RecordedFrame::new(&placed, &view, &settings);
        renderer.record(adopt(&context, &frame), 0, &recorded).expect("a recording");
        // SAFETY: recording state.
        unsafe {
            let (from, to) = (vk::PipelineStageFlags::HOST, vk::PipelineStageFlags::ALL_COMMANDS);
            host.device.cmd_wait_events(frame.commands, &[gate], from, to, &[], &[], &[]);
        }
        frame.submit(host).expect("a submission");
        let start = std::time::Instant::now();
        let mut finished = renderer.slot_finished(0);
        while matches!(finished, Ok(false)) && start.elapsed().as_secs() < 20 {
            std::thread::yield_now();
            finished = renderer.slot_finished(0);
        }
        let report = renderer.slot_report(0);
        // First let the device go on, whatever the results.
        // SAFETY: the event is alive until the submission is over.
        unsafe { host.device.set_event(gate) }.expect("set");
        frame.wait(host).expect("done");
        assert!(finished.expect("a status"), "not finished before the host's own commands");
        let report = report.expect("a report").expect("the frame was done");
        assert!(report.visible > 100 && !report.overflow && report.scopes.is_empty(), "{report:?}");
        // SAFETY: nothing waits for it any more.
        unsafe { host.device.destroy_event(gate, None) };
        frame.destroy(host);
    });
}

/// A test fails if it leaks an object of the device.
#[test]
#[should_panic(expected = "vkDestroyDevice")]
fn leaks_are_seen() {
    assert!(options().validation, "vkDestroyDevice is checked by the layer, which is missing");
    with_host(&options(), |host| {
        // SAFETY: a valid create info; the device is destroyed without it.
        let _ = unsafe { host.device.create_event(&vk::EventCreateInfo::default(), None) }.expect("an event");
    });
}

/// A report stays the same however often it is read.
#[test]
fn a_report_is_kept() {
    with_host(&options(), |host| {
        let context = guest(host);
        let mut renderer = renderer(&context, 1);
        let scene = DeviceScene::upload(&context, &cloud(300, 1), 0).expect("a scene");
        let (settings, view, placed) = (RenderSettings::default(), camera(0.3, 64, 48), [(&scene).into()]);
        rendered(host, &mut renderer, &RecordedFrame::new(&placed, &view, &settings));
        let report = renderer.slot_report(0).expect("a report").expect("finished");
        assert_eq!(report.scopes.is_empty(), context.limits().timestamp_period_ns == 0.0, "{report:?}");
        assert_eq!(renderer.slot_report(0).expect("a report"), Some(report));
    });
}

/// A recording that a panic or an error interrupts leaks nothing. Its slot can be used again once it is discarded.
#[test]
fn an_unfinished_recording_gives_everything_back() {
    for push_descriptors in [true, false] {
        with_host(&HostOptions { push_descriptors, ..options() }, unfinished);
    }
}

fn unfinished(host: &Host) {
    let context = guest(host);
    let mut slot = RecordSlot::new(&context, 4).expect("a slot");
    let request = [("small", 16), ("large", 64)];
    let buffers = context.allocate("test", &request, MemoryKind::Device).expect("memory");
    for _ in 0..2 {
        let frame = InFlight::new(host).expect("a command buffer");
        frame.begin(host).expect("recording");
        let mut recorder = slot.begin(adopt(&context, &frame), "test").expect("a recorder");
        let panicked = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
            recorder.fill(&buffers[1], 1);
            recorder.copy(&buffers[1], &buffers[0]);
        }));
        assert!(panicked.is_err(), "a copy that does not fit");
        drop(recorder);
        // The host may or may not execute the recording.
        assert!(!slot.finished().expect("a status"));
        let error = slot.begin(adopt(&context, &frame), "test").err().expect("in flight");
        assert!(error.to_string().contains("in flight"), "{error}");
        frame.destroy(host);
        // SAFETY: the command buffer is gone without having been submitted.
        unsafe { slot.discard() };
    }
    let frame = InFlight::new(host).expect("a command buffer");
    frame.begin(host).expect("recording");
    let mut recorder = slot.begin(adopt(&context, &frame), "test").expect("a recorder");
    recorder.fill(&buffers[1], 1);
    slot.end(recorder).expect("recorded");
    frame.submit(host).expect("a submission");
    frame.wait(host).expect("done");
    assert!(slot.finished().expect("a status"));
    frame.destroy(host);
}

/// A leaked recorder takes its slot's objects along. The slot is in flight until it is discarded, and then works as
/// before. A leaked slot blocks nothing.
#[test]
fn leaked_recorders_and_slots_block_nothing() {
    for push_descriptors in [true, false] {
        // Leaked objects are never destroyed, which validation would report at the device's end.
        let host =
            Host::new(&HostOptions { push_descriptors, validation: false, ..options() }).expect("a host");
        let context = guest(&host);
        let (gaussians, view, settings) = (cloud(300, 1), camera(0.3, 64, 48), RenderSettings::default());
        let expected = owned(&gaussians, &view, &settings);
        let scene = DeviceScene::upload(&context, &gaussians, 0).expect("a scene");
        let kernel = Kernel::<multiply_add::Interface>::new(
            &context,
            &multiply_add::Interface::spec_for(context.limits()),
        );
        let kernel = kernel.expect("a kernel");
        let request = [("results", 1024)];
        let results = &context.allocate("test", &request, MemoryKind::Device).expect("memory")[0];
        let frame = InFlight::new(&host).expect("a command buffer");
        let record = |slot: &mut RecordSlot| {
            frame.begin(&host).expect("recording");
            let mut recorder = slot.begin(adopt(&context, &frame), "test").expect("a recorder");
            let push = multiply_add::Push { count: 256, factor: 0.0, term: 1.0 };
            for _ in 0..4 {
                recorder.dispatch(&kernel, &multiply_add::Bind { results }, &push, 4);
                recorder.barrier();
            }
            recorder
        };
        let mut slot = RecordSlot::new(&context, 4).expect("a slot");
        std::mem::forget(record(&mut slot));
        assert!(!slot.finished().expect("a status"));
        // SAFETY: the command buffer was not submitted, and is begun anew below.
        unsafe { slot.discard() };
        let recorder = record(&mut slot);
        slot.end(recorder).expect("recorded");
        frame.submit(&host).expect("a submission");
        frame.wait(&host).expect("done");
        assert!(slot.finished().expect("a status"));
        let sums: Vec<f32> = bytemuck::pod_collect_to_vec(&context.download(results).expect("bytes"));
        assert!(sums.iter().all(|&sum| sum > 0.0), "{sums:?}");
        // Once more, with the slot leaked.
        let recorder = record(&mut slot);
        slot.end(recorder).expect("recorded");
        std::mem::forget(slot);
        let mut renderer = renderer(&context, 1);
        let placed = [(&scene).into()];
        for _ in 0..2 {
            let pixels = rendered(&host, &mut renderer, &RecordedFrame::new(&placed, &view, &settings));
            assert_same(&pixels, &expected, [0.0; 3]);
        }
        frame.destroy(&host);
    }
}

/// A discarded recording has no report, not even the previous one.
#[test]
fn a_discarded_recording_has_no_report() {
    with_host(&options(), |host| {
        let context = guest(host);
        let mut renderer = renderer(&context, 1);
        let (gaussians, view) = (cloud(300, 1), camera(0.3, 64, 48));
        let scene = DeviceScene::upload(&context, &gaussians, 0).expect("a scene");
        let (settings, placed) = (RenderSettings::default(), [(&scene).into()]);
        let recorded = RecordedFrame::new(&placed, &view, &settings);
        assert_eq!(renderer.slot_report(0).expect("a report"), None, "never recorded");
        rendered(host, &mut renderer, &recorded);
        assert!(renderer.slot_report(0).expect("a report").is_some());
        let frame = InFlight::new(host).expect("a command buffer");
        frame.begin(host).expect("recording");
        renderer.record(adopt(&context, &frame), 0, &recorded).expect("a recording");
        frame.destroy(host);
        // SAFETY: the command buffer was freed without ever being submitted.
        unsafe { renderer.slot_recording(0).expect("a slot").discard() };
        assert_eq!(renderer.slot_report(0).expect("a report"), None);
        let pixels = rendered(host, &mut renderer, &recorded);
        assert_same(&pixels, &owned(&gaussians, &view, &settings), [0.0; 3]);
        assert!(renderer.slot_report(0).expect("a report").is_some());
    });
}

/// The sum of weights / z can be read from the slot like the pixels.
#[test]
fn inverse_depth_lies_in_the_slot() {
    with_host(&options(), |host| {
        let context = guest(host);
        let mut renderer = renderer(&context, 1);
        let (gaussians, view) = (cloud(300, 1), camera(0.3, 64, 48));
        let scene = DeviceScene::upload(&context, &gaussians, 0).expect("a scene");
        let settings = RenderSettings { inverse_depth: true, ..RenderSettings::default() };
        let placed = [(&scene).into()];
        rendered(host, &mut renderer, &RecordedFrame::new(&placed, &view, &settings));
        let (from, offset) = renderer.slot_inverse_depth(0).expect("a slot").handle();
        let bytes = pixels_of(&view) * 4;
        let staging = HostBuffer::new(host, bytes).expect("memory");
        let copied = host.run(|commands| {
            let region = vk::BufferCopy::default().src_offset(offset).size(bytes);
            // SAFETY: recording state; both buffers hold a float for each pixel.
            unsafe { host.device.cmd_copy_buffer(commands, from, staging.raw, &[region]) };
            staging.to_host(host, commands);
            Ok(())
        });
        copied.expect("copied");
        let read: Vec<f32> =
            bytemuck::pod_collect_to_vec(&staging.read(host, bytes as usize).expect("bytes"));
        assert_eq!(Some(read), owned(&gaussians, &view, &settings).inverse_depth);
        staging.destroy(host);
    });
}

/// A device of the engine's, lent to a host: its kernels must not need views that only recording creates.
#[test]
fn a_device_of_our_own_records_for_a_host() {
    let (gaussians, view) = (cloud(300, 1), camera(0.3, 64, 48));
    let settings = RenderSettings::default();
    let own = Context::new(&ContextOptions { texels: false, ..ContextOptions::default() }).expect("a device");
    let (_, _, device, queue_family) = own.handles();
    let scene = DeviceScene::upload(&own, &gaussians, 0).expect("a scene");
    let mut renderer = renderer(&own, 1);
    // SAFETY: valid create infos; the command buffer is waited for before anything of it is destroyed; the queue is used
    // by this thread alone.
    unsafe {
        let pool = vk::CommandPoolCreateInfo::default().queue_family_index(queue_family);
        let pool = device.create_command_pool(&pool, None).expect("a pool");
        let commands = vk::CommandBufferAllocateInfo::default().command_pool(pool).command_buffer_count(1);
        let commands = device.allocate_command_buffers(&commands).expect("a command buffer")[0];
        device.begin_command_buffer(commands, &vk::CommandBufferBeginInfo::default()).expect("begun");
        let placed = [(&scene).into()];
        let adopted = own.adopt_commands(commands).expect("adopted");
        renderer.record(adopted, 0, &RecordedFrame::new(&placed, &view, &settings)).expect("a recording");
        device.end_command_buffer(commands).expect("ended");
        let (buffers, queue) = ([commands], device.get_device_queue(queue_family, 0));
        let submit = vk::SubmitInfo::default().command_buffers(&buffers);
        device.queue_submit(queue, &[submit], vk::Fence::null()).expect("a submission");
        device.queue_wait_idle(queue).expect("done");
        device.destroy_command_pool(pool, None);
    }
    let pixels = renderer.slot_pixels(0).expect("a slot").range(0, pixels_of(&view) * 16);
    let pixels: Vec<[f32; 4]> = bytemuck::pod_collect_to_vec(&own.download(&pixels).expect("pixels"));
    assert_same(&pixels, &owned(&gaussians, &view, &settings), settings.background);

    let usual = Context::new(&ContextOptions::default()).expect("a device");
    if usual.limits().prefers_texels() {
        // SAFETY: refused before anything is done with the handles.
        let refused = unsafe {
            [
                usual.adopt_commands(vk::CommandBuffer::from_raw(1)).err(),
                Buffer::adopt(&usual, "none", vk::Buffer::from_raw(1), 0, 256).err(),
            ]
        };
        for error in refused {
            let text = error.expect("refused").to_string();
            assert!(text.contains("ContextOptions::texels") && !text.contains('\n'), "{text}");
        }
    }
}

fn pixels_of(camera: &Camera) -> u64 {
    u64::from(camera.width) * u64::from(camera.height)
}
