//! How long a slot keeps the objects of its recording, and the fate of recordings that are not executed.

use crate::stage::*;
use ashsplat::ash::vk::Handle;
use ashsplat::kernels::arithmetic::multiply_add;
use ashsplat::vk::{Kernel, KernelInterface, RecordSlot};

fn renderer(context: &Context, slots: u32) -> Renderer {
    let reservation =
        Reservation { slots, inverse_depth: true, scenes: 2, ..Reservation::new(1600, 1, 64, 48) };
    reserved(context, &reservation)
}

fn scene_bytes(context: &Context) -> u64 {
    context.memory().iter().find(|arena| arena.name == "scene").map_or(0, |arena| arena.bytes)
}

#[test]
fn what_is_dropped_lives_as_long_as_its_slots_need_it() {
    with_guest(|host, context| {
        let mut renderer = renderer(&context, 2);
        let (gaussians, view) = (cloud(300, 1), camera(0.3, 64, 48));
        let scene = uploaded(&context, &gaussians);
        let bytes = scene_bytes(&context);
        let usage = vk::ImageUsageFlags::STORAGE;
        let texture = Texture::new(host, vk::Format::R8G8B8A8_UNORM, usage, [64, 48]);
        let image = texture.adopt(&context, "target", ImageUse::Target);
        let frames = [0; 2].map(|_| Commands::new(host));
        let placed = [Placed::from(&scene)];
        for (slot, frame) in (0..).zip(&frames) {
            let to = host_image(&image, if slot == 0 { ImageState::UNDEFINED } else { WRITTEN });
            let target =
                Target::Image { to, behind: Background::Nothing, encoding: ColorEncoding::AsTrained };
            let recorded = RecordedFrame { target, ..frame_of(&placed, &view) };
            renderer.record(frame.begun(&context), slot, &recorded).expect("a recording");
            assert_error(renderer.release_slot(slot), "in flight");
            frame.submit();
        }
        drop((scene, image));
        assert_eq!(scene_bytes(&context), bytes);
        frames[0].wait();
        renderer.release_slot(0).expect("over");
        assert_eq!(scene_bytes(&context), bytes, "the other frame may still use it");
        frames[1].wait();
        // The slot's next recording releases the scene, too.
        let other = DeviceScene::empty(&context, 1, 0).expect("a scene");
        let others = [Placed::from(&other)];
        let recorded = frame_of(&others, &view);
        renderer.record(frames[1].begun(&context), 1, &recorded).expect("a recording");
        frames[1].finish();
        assert!(scene_bytes(&context) < bytes, "it has no user any more");
    });
}

/// The guest's own commands finish before later commands of the host.
#[test]
fn a_report_does_not_wait_for_the_hosts_own_commands() {
    with_host(&options(), |host| {
        // On llvmpipe, a query of timestamps waits for the whole device.
        let without_times =
            ContextOptions { timestamps: false, hazard_check: true, ..ContextOptions::default() };
        let context = guest_of(&host.foreign(), &without_times);
        let mut renderer = renderer(&context, 1);
        let scene = uploaded(&context, &cloud(300, 1));
        let (view, placed) = (camera(0.3, 64, 48), [(&scene).into()]);
        let frame = Commands::new(host);
        let gate = Gate::closed(host);
        let recorded = frame_of(&placed, &view);
        renderer.record(frame.begun(&context), 0, &recorded).expect("a recording");
        gate.record_wait(frame.commands);
        frame.submit();
        let start = std::time::Instant::now();
        let mut finished = renderer.slot_finished(0);
        while matches!(finished, Ok(false)) && start.elapsed().as_secs() < 20 {
            std::thread::yield_now();
            finished = renderer.slot_finished(0);
        }
        let report = renderer.slot_report(0);
        // First let the device go on, whatever the results.
        gate.open();
        frame.wait();
        assert!(finished.expect("a status"), "not finished before the host's own commands");
        let report = report.expect("a report").expect("the frame was done");
        assert!(report.visible > 100 && !report.overflow && report.scopes.is_empty(), "{report:?}");
    });
}

/// A recording that a panic or an error interrupts leaks nothing. Its slot can be used again once it is discarded.
#[test]
fn an_unfinished_recording_gives_everything_back() {
    with_each_guest(|host, context| {
        let mut slot = RecordSlot::new(&context, 4).expect("a slot");
        let request = [("small", 16), ("large", 64)];
        let buffers = context.allocate("test", &request, MemoryKind::Device).expect("memory");
        for _ in 0..2 {
            let frame = Commands::new(host);
            let mut recorder = slot.begin(frame.begun(&context), "test").expect("a recorder");
            let panicked = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
                recorder.fill(&buffers[1], 1);
                recorder.copy(&buffers[1], &buffers[0]);
            }));
            assert!(panicked.is_err(), "a copy that does not fit");
            drop(recorder);
            // The host may or may not execute the recording.
            assert!(!slot.finished().expect("a status"));
            assert_error(slot.begin(frame.adopt(&context), "test"), "in flight");
            drop(frame);
            // SAFETY: the command buffer is gone without having been submitted.
            unsafe { slot.discard() };
        }
        let frame = Commands::new(host);
        let mut recorder = slot.begin(frame.begun(&context), "test").expect("a recorder");
        recorder.fill(&buffers[1], 1);
        slot.end(recorder).expect("recorded");
        frame.finish();
        assert!(slot.finished().expect("a status"));
    });
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
        let (gaussians, view) = (cloud(300, 1), camera(0.3, 64, 48));
        let scene = uploaded(&context, &gaussians);
        let kernel = Kernel::<multiply_add::Interface>::new(
            &context,
            &multiply_add::Interface::spec_for(context.limits()),
        );
        let kernel = kernel.expect("a kernel");
        let request = [("results", 1024)];
        let results = &context.allocate("test", &request, MemoryKind::Device).expect("memory")[0];
        let frame = Commands::new(&host);
        let record = |slot: &mut RecordSlot| {
            let mut recorder = slot.begin(frame.begun(&context), "test").expect("a recorder");
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
        frame.finish();
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
            assert_drawn(&host, &mut renderer, &frame_of(&placed, &view), &gaussians);
        }
    }
}

#[test]
fn a_discarded_recording_has_no_report() {
    with_guest(|host, context| {
        let mut renderer = renderer(&context, 1);
        let (gaussians, view) = (cloud(300, 1), camera(0.3, 64, 48));
        let scene = uploaded(&context, &gaussians);
        let placed = [(&scene).into()];
        let recorded = frame_of(&placed, &view);
        assert_eq!(renderer.slot_report(0).expect("a report"), None, "never recorded");
        rendered(host, &mut renderer, &recorded);
        assert!(renderer.slot_report(0).expect("a report").is_some());
        let frame = Commands::new(host);
        renderer.record(frame.begun(&context), 0, &recorded).expect("a recording");
        drop(frame);
        assert!(!renderer.slot_finished(0).expect("a status"));
        // SAFETY: the command buffer was freed without ever being submitted.
        unsafe { renderer.slot_recording(0).expect("a slot").discard() };
        assert_eq!(renderer.slot_report(0).expect("a report"), None);
        assert_drawn(host, &mut renderer, &recorded, &gaussians);
        assert!(renderer.slot_report(0).expect("a report").is_some());
    });
}

#[test]
fn inverse_depth_lies_in_the_slot() {
    with_guest(|host, context| {
        let mut renderer = renderer(&context, 1);
        let (gaussians, view) = (cloud(300, 1), camera(0.3, 64, 48));
        let scene = uploaded(&context, &gaussians);
        let settings = RenderSettings { inverse_depth: true, ..RenderSettings::default() };
        let placed = [(&scene).into()];
        rendered(host, &mut renderer, &RecordedFrame::new(&placed, &view, &settings));
        let (from, offset) = renderer.slot_inverse_depth(0).expect("a slot").handle();
        let bytes = pixels_of(&view) * 4;
        let staging = Staging::new(host, bytes);
        let copied = host.run(|commands| {
            let region = vk::BufferCopy::default().src_offset(offset).size(bytes);
            // SAFETY: recording state; both buffers hold a float for each pixel.
            unsafe { host.device.cmd_copy_buffer(commands, from, staging.raw, &[region]) };
            staging.to_host(host, commands);
            Ok(())
        });
        copied.expect("copied");
        assert_eq!(Some(staging.read()), owned(&gaussians, &view, &settings).inverse_depth);
    });
}

/// A device of the engine's, lent to a host: its kernels must not need views that only recording creates.
#[test]
fn a_device_of_our_own_records_for_a_host() {
    let (gaussians, view) = (cloud(300, 1), camera(0.3, 64, 48));
    let own = Context::new(&ContextOptions { texels: false, ..ContextOptions::default() }).expect("a device");
    let (_, _, device, queue_family) = own.handles();
    let scene = uploaded(&own, &gaussians);
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
        renderer.record(adopted, 0, &frame_of(&placed, &view)).expect("a recording");
        device.end_command_buffer(commands).expect("ended");
        let (buffers, queue) = ([commands], device.get_device_queue(queue_family, 0));
        let submit = vk::SubmitInfo::default().command_buffers(&buffers);
        device.queue_submit(queue, &[submit], vk::Fence::null()).expect("a submission");
        device.queue_wait_idle(queue).expect("done");
        device.destroy_command_pool(pool, None);
    }
    let pixels = renderer.slot_pixels(0).expect("a slot").range(0, pixels_of(&view) * 16);
    let pixels: Vec<[f32; 4]> = bytemuck::pod_collect_to_vec(&own.download(&pixels).expect("pixels"));
    assert_same(&pixels, &owned(&gaussians, &view, &SETTINGS));

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
