//! Memory of frames in flight: what slots share, growth while frames are in flight, and a host's own block.

use crate::auxiliary::flight::Flight;
use crate::auxiliary::truth::both;
use crate::host::{Host, InFlight};
use crate::memory::HostBuffer;
use crate::stage::{
    adopt, assert_same, camera, cloud, copy_pixels, guest, options, owned, rendered, with_host,
};
use ashsplat::ash::vk;
use ashsplat::vk::{Buffer, Context, ContextOptions};
use ashsplat::{Camera, DeviceScene, Error, Placed, RecordedFrame, RenderSettings, Renderer, Reservation};

const SIZE: [u32; 2] = [96, 80];
const PIXELS: usize = 96 * 80;

/// Bytes of device memory for frames.
fn slot_bytes(context: &Context) -> u64 {
    let memory = context.memory();
    memory.iter().find(|arena| arena.name == "frame slot").map_or(0, |arena| arena.bytes)
}

/// Slots of one queue share their working memory, with a million Gaussians at 1920 x 1080.
#[test]
fn slots_of_a_queue_share_what_lives_within_a_frame() {
    with_host(&options(), |host| {
        let context = guest(host);
        let mut renderer = Renderer::new(&context).expect("kernels");
        let wanted = Reservation { occlusion: true, ..Reservation::new(1_000_000, 3, 1920, 1080) };
        let mut bytes = |slots, queues, images_only| {
            let wanted = Reservation { slots, queues, images_only, ..wanted };
            renderer.reserve(&wanted).expect("memory");
            let bytes = slot_bytes(&context);
            let planned = renderer.reservation_bytes(&wanted).expect("a plan");
            assert!(bytes.abs_diff(planned) < 4096, "{bytes} bytes, planned {planned}");
            bytes
        };
        let one = bytes(1, 1, true);
        assert!(one > 250 << 20, "{one}");
        // The limit is 1.15 times one slot.
        assert_eq!([bytes(2, 1, true), bytes(3, 1, true)], [one; 2]);
        // The pixels belong to the host until it records the slot again.
        assert_eq!([bytes(1, 1, false), bytes(3, 1, false)], [one, one + 2 * 16 * 1920 * 1080]);
        // One queue per slot, and more queues than slots.
        assert_eq!([bytes(2, 2, true), bytes(2, 7, false)], [2 * one; 2]);
    });
}

fn submitted<'a>(
    host: &Host,
    renderer: &mut Renderer,
    (slot, frame, staging): (u32, &'a InFlight, &HostBuffer),
    recorded: &RecordedFrame<'_>,
) -> &'a InFlight {
    frame.begin(host).expect("recording");
    let commands = adopt(renderer.context(), frame);
    renderer.record(commands, slot, recorded).expect("a recording");
    copy_pixels(host, renderer, slot, frame, staging, PIXELS);
    frame
}

fn pixels(host: &Host, staging: &HostBuffer) -> Vec<[f32; 4]> {
    bytemuck::pod_collect_to_vec(&staging.read(host, 16 * PIXELS).expect("bytes"))
}

/// Every frame starts after all submitted before it, in whatever order they were recorded.
#[test]
fn frames_that_share_memory_may_be_submitted_in_any_order() {
    with_host(&options(), |host| {
        let context = guest(host);
        let gaussians = cloud(900, 4);
        let scene = DeviceScene::upload(&context, &gaussians, 0).expect("a scene");
        let mut renderer = Renderer::new(&context).expect("kernels");
        renderer
            .reserve(&Reservation { slots: 3, ..Reservation::new(900, 1, SIZE[0], SIZE[1]) })
            .expect("memory");
        let (settings, scenes) = (RenderSettings::default(), [(&scene).into()]);
        let cameras = [0.0, 1.0, 2.0].map(|turn| camera(turn, SIZE[0], SIZE[1]));
        let frames = [0; 3].map(|_| InFlight::new(host).expect("a command buffer"));
        let staging = [0; 3].map(|_| HostBuffer::new(host, 16 * PIXELS as u64).expect("memory"));
        let expected = cameras.map(|camera| owned(&gaussians, &camera, &settings));
        for order in [[0, 1, 2], [2, 0, 1], [2, 1, 0]] {
            for slot in 0..3 {
                let recorded = RecordedFrame::new(&scenes, &cameras[slot], &settings);
                submitted(host, &mut renderer, (slot as u32, &frames[slot], &staging[slot]), &recorded);
            }
            for slot in order {
                frames[slot].submit(host).expect("a submission");
            }
            frames.iter().for_each(|frame| frame.wait(host).expect("done"));
            for slot in 0..3 {
                assert_same(&pixels(host, &staging[slot]), &expected[slot], [0.0; 3]);
                let report = renderer.slot_report(slot as u32).expect("a report").expect("finished");
                assert_eq!(report.visible, expected[slot].stats.visible);
                assert_eq!(report.instances_needed, expected[slot].stats.instances);
            }
        }
        staging.into_iter().for_each(|staging| staging.destroy(host));
        frames.into_iter().for_each(|frame| frame.destroy(host));
    });
}

/// The second frame in a command buffer writes memory that the first one reads. Synchronization validation checks
/// that it waits.
#[test]
fn frames_of_one_command_buffer_share_memory() {
    with_host(&options(), |host| {
        // Timestamps add barriers.
        let options = ContextOptions { timestamps: false, ..ContextOptions::default() };
        // SAFETY: as in `guest`.
        let context = unsafe { Context::from_foreign(&host.foreign(), &options) }.expect("a context");
        let gaussians = cloud(900, 4);
        let scene = DeviceScene::upload(&context, &gaussians, 0).expect("a scene");
        let mut renderer = Renderer::new(&context).expect("kernels");
        let wanted = Reservation { slots: 2, ..Reservation::new(900, 1, SIZE[0], SIZE[1]) };
        renderer.reserve(&both(wanted)).expect("memory");
        let (settings, scenes) = (RenderSettings::default(), [(&scene).into()]);
        let cameras = [0.0, 1.0].map(|turn| camera(turn, SIZE[0], SIZE[1]));
        let staging = [0; 2].map(|_| HostBuffer::new(host, 16 * PIXELS as u64).expect("memory"));
        let frame = InFlight::new(host).expect("a command buffer");
        let mut flights = [0; 2].map(|_| Flight::new(host, &context, SIZE));
        frame.begin(host).expect("recording");
        // Each camera's previous position is that of the other.
        for (slot, camera) in cameras.iter().enumerate() {
            let recorded = RecordedFrame::new(&scenes, camera, &settings);
            let recorded = flights[slot].with(recorded, &cameras[1 - slot], [true; 2]);
            renderer.record(adopt(&context, &frame), slot as u32, &recorded).expect("a recording");
        }
        flights.iter_mut().for_each(|flight| flight.record_read(&frame, [true; 2]));
        for (slot, staging) in (0..).zip(&staging) {
            copy_pixels(host, &mut renderer, slot, &frame, staging, PIXELS);
        }
        frame.submit(host).expect("a submission");
        frame.wait(host).expect("done");
        let alone = Flight::new(host, &context, SIZE);
        for (slot, flight) in flights.iter().enumerate() {
            let drawn = RecordedFrame::new(&scenes, &cameras[slot], &settings);
            rendered(host, &mut renderer, &alone.with(drawn, &cameras[1 - slot], [true; 2]));
            let expected = alone.now([true; 2]);
            assert!(expected.1.iter().any(|motion| *motion != [0; 2]));
            assert!(flight.read([true; 2]) == expected, "frame {slot} has others beside it");
        }
        for (camera, staging) in cameras.iter().zip(staging) {
            assert_same(&pixels(host, &staging), &owned(&gaussians, camera, &settings), [0.0; 3]);
            staging.destroy(host);
        }
        drop(renderer);
        flights.into_iter().chain([alone]).for_each(Flight::destroy);
        frame.destroy(host);
    });
}

/// Two slots are in flight with too little capacity while the third gets more.
#[test]
fn memory_grows_while_frames_fly() {
    with_host(&options(), |host| {
        let context = guest(host);
        let (gaussians, view) = (cloud(900, 9), camera(0.2, SIZE[0], SIZE[1]));
        let scene = DeviceScene::upload(&context, &gaussians, 0).expect("a scene");
        let mut renderer = Renderer::new(&context).expect("kernels");
        let small = Reservation { slots: 3, instances: 100, ..Reservation::new(900, 1, SIZE[0], SIZE[1]) };
        let error = renderer.grow(&small).expect_err("nothing to grow");
        assert!(error.to_string().contains("none are reserved that could grow"), "{error}");
        renderer.reserve(&small).expect("memory");
        let before = slot_bytes(&context);
        let (settings, scenes) = (RenderSettings::default(), [(&scene).into()]);
        let recorded = RecordedFrame::new(&scenes, &view, &settings);
        let frames = [0; 3].map(|_| InFlight::new(host).expect("a command buffer"));
        let staging = [0; 3].map(|_| HostBuffer::new(host, 16 * PIXELS as u64).expect("memory"));
        // SAFETY: a valid create info; the event is set below, so that the device goes on.
        let gate = unsafe { host.device.create_event(&vk::EventCreateInfo::default(), None) };
        let gate = gate.expect("an event");
        for (slot, frame) in (0..).zip(&frames[..2]) {
            frame.begin(host).expect("recording");
            // SAFETY: recording state.
            unsafe {
                let (from, to) = (vk::PipelineStageFlags::HOST, vk::PipelineStageFlags::ALL_COMMANDS);
                host.device.cmd_wait_events(frame.commands, &[gate], from, to, &[], &[], &[]);
            }
            let commands = adopt(&context, frame);
            renderer.record(commands, slot, &recorded).expect("a recording");
            frame.submit(host).expect("a submission");
        }
        // Both wait for the host, so nothing below can have waited for them.
        let enough = Reservation { instances: 60_000, ..small };
        let error = renderer.grow(&Reservation { slots: 2, ..enough }).expect_err("another number of slots");
        assert!(error.to_string().contains("slots is 2, 3 are reserved"), "{error}");
        let error = renderer.grow(&Reservation { gaussians: u32::MAX, ..small }).expect_err("too many");
        assert!(matches!(error, Error::TooLarge { .. }), "{error}");
        assert_eq!(slot_bytes(&context), before, "nothing is left of what was refused");
        renderer.grow(&enough).expect("memory");
        let both = slot_bytes(&context);
        submitted(host, &mut renderer, (2, &frames[2], &staging[2]), &recorded)
            .submit(host)
            .expect("submitted");
        assert!(
            !renderer.slot_finished(0).expect("a status") && !renderer.slot_finished(2).expect("a status")
        );
        // SAFETY: the event is alive until the submissions are over.
        unsafe { host.device.set_event(gate) }.expect("set");
        frames.iter().for_each(|frame| frame.wait(host).expect("done"));

        let expected = owned(&gaussians, &view, &settings);
        assert_same(&pixels(host, &staging[2]), &expected, [0.0; 3]);
        let reports = [0, 1, 2].map(|slot| renderer.slot_report(slot).expect("a report").expect("finished"));
        let said = reports.map(|report| (report.overflow, report.instance_capacity));
        assert_eq!(said, [(true, 100), (true, 100), (false, 60_000)]);
        // A reservation that fits allocates nothing.
        let held = slot_bytes(&context);
        assert!(before < held && held <= both);
        renderer.grow(&enough).expect("nothing");
        assert_eq!(slot_bytes(&context), held);
        // A released slot keeps its pixels and hence the old memory.
        let old = renderer.slot_pixels(0).expect("pixels");
        renderer.release_slot(0).expect("over");
        assert!(renderer.slot_pixels(0).expect("pixels").handle() == old.handle());
        assert_eq!(slot_bytes(&context), held);
        submitted(host, &mut renderer, (1, &frames[1], &staging[1]), &recorded)
            .submit(host)
            .expect("submitted");
        frames[1].wait(host).expect("done");
        assert_same(&pixels(host, &staging[1]), &expected, [0.0; 3]);
        let grown = slot_bytes(&context);
        renderer.reserve(&enough).expect("memory");
        assert_eq!(slot_bytes(&context), grown, "nothing is left of the old memory");
        // SAFETY: nothing waits for it any more.
        unsafe { host.device.destroy_event(gate, None) };
        staging.into_iter().for_each(|staging| staging.destroy(host));
        frames.into_iter().for_each(|frame| frame.destroy(host));
    });
}

/// A host's buffer for frames, with its memory.
struct HostBlock(vk::Buffer, vk::DeviceMemory);

impl HostBlock {
    fn new(host: &Host, bytes: u64) -> Self {
        let usage = vk::BufferUsageFlags::STORAGE_BUFFER
            | vk::BufferUsageFlags::UNIFORM_BUFFER
            | vk::BufferUsageFlags::INDIRECT_BUFFER
            | vk::BufferUsageFlags::TRANSFER_SRC
            | vk::BufferUsageFlags::TRANSFER_DST;
        let info = vk::BufferCreateInfo::default().size(bytes).usage(usage);
        // SAFETY: a valid create info; the buffer is bound once to memory of its own.
        unsafe {
            let raw = host.device.create_buffer(&info, None).expect("a buffer");
            let needs = host.device.get_buffer_memory_requirements(raw);
            let memory = host.allocate(needs, vk::MemoryPropertyFlags::DEVICE_LOCAL).expect("memory");
            host.device.bind_buffer_memory(raw, memory, 0).expect("bound");
            Self(raw, memory)
        }
    }

    fn adopt(&self, context: &Context, offset: u64, bytes: u64) -> Buffer {
        // SAFETY: the buffer is as `new` has made it, and outlives the renderer.
        unsafe { Buffer::adopt(context, "host's frames", self.0, offset, bytes) }.expect("adopted")
    }

    fn destroy(self, host: &Host) {
        // SAFETY: nothing uses it any more.
        unsafe {
            host.device.destroy_buffer(self.0, None);
            host.device.free_memory(self.1, None);
        }
    }
}

#[test]
fn a_hosts_block_holds_all_slots() {
    with_host(&options(), |host| {
        let context = guest(host);
        let gaussians = cloud(900, 4);
        let scene = DeviceScene::upload(&context, &gaussians, 0).expect("a scene");
        let mut renderer = Renderer::new(&context).expect("kernels");
        let small = Reservation { slots: 2, instances: 100, ..Reservation::new(900, 1, SIZE[0], SIZE[1]) };
        let large = Reservation { instances: 60_000, ..small };
        let bytes = [&small, &large].map(|wanted| renderer.reservation_bytes(wanted).expect("a plan"));
        let block = HostBlock::new(host, 512 + bytes[0] + bytes[1]);
        let parts = [block.adopt(&context, 256, bytes[0]), block.adopt(&context, 256 + bytes[0], bytes[1])];
        let error = renderer.reserve_in(&large, &parts[0]).expect_err("too small");
        assert!(
            matches!(error, Error::TooLarge { needed, limit, .. } if [limit, needed] == bytes),
            "{error}"
        );
        let other = guest(host);
        let error = renderer.reserve_in(&small, &block.adopt(&other, 256, bytes[0])).expect_err("of another");
        assert!(error.to_string().contains("another context"), "{error}");
        renderer.reserve_in(&small, &parts[0]).expect("room");
        assert_eq!(slot_bytes(&context), 0, "all of it is the host's");

        let (settings, placed) = (RenderSettings::default(), [Placed::from(&scene)]);
        let draw = |renderer: &mut Renderer, view: &Camera| {
            rendered(host, renderer, &RecordedFrame::new(&placed, view, &settings))
        };
        let view = camera(0.4, SIZE[0], SIZE[1]);
        draw(&mut renderer, &view);
        assert!(renderer.slot_report(0).expect("a report").expect("finished").overflow);
        renderer.grow_in(&large, &parts[1]).expect("room");
        for turn in [0.4, 1.4] {
            let view = camera(turn, SIZE[0], SIZE[1]);
            assert_same(&draw(&mut renderer, &view), &owned(&gaussians, &view, &settings), [0.0; 3]);
        }
        assert_eq!(slot_bytes(&context), 0);
        drop((renderer, parts));
        block.destroy(host);
    });
}
