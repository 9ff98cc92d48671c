//! Memory of frames in flight: what slots share, growth while frames are in flight, and a host's own block.

use crate::auxiliary::flight::Flight;
use crate::auxiliary::truth::both;
use crate::stage::*;

const SIZE: [u32; 2] = [96, 80];
const PIXELS: usize = 96 * 80;

fn slot_bytes(context: &Context) -> u64 {
    let memory = context.memory();
    memory.iter().find(|arena| arena.name == "frame slot").map_or(0, |arena| arena.bytes)
}

/// Slots of one queue share their working memory, with a million Gaussians at 1920 x 1080.
#[test]
fn slots_of_a_queue_share_what_lives_within_a_frame() {
    with_guest(|_, context| {
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
        // The frame would take 278 MiB if each buffer had memory of its own.
        assert!((150 << 20..220 << 20).contains(&one), "{one}");
        // The limit is 1.15 times one slot.
        assert_eq!([bytes(2, 1, true), bytes(3, 1, true)], [one; 2]);
        // The pixels belong to the host until it records the slot again, so other slots' frames leave them alone.
        let (pixels, three) = (16 * 1920 * 1080, bytes(3, 1, false));
        assert_eq!(bytes(1, 1, false), one);
        assert!((one + 2 * pixels..one + 3 * pixels + (1 << 20)).contains(&three), "{three}");
        // One queue per slot, and more queues than slots.
        assert_eq!([bytes(2, 2, true), bytes(2, 7, false)], [2 * one; 2]);
    });
}

fn record(
    renderer: &mut Renderer,
    (slot, commands, staging): (u32, &Commands<'_>, &Staging<'_>),
    frame: &RecordedFrame<'_>,
) {
    renderer.record(commands.begun(renderer.context()), slot, frame).expect("a recording");
    copy_pixels(renderer, slot, commands, staging);
}

#[test]
fn frames_that_share_memory_may_be_submitted_in_any_order() {
    with_guest(|host, context| {
        let gaussians = cloud(900, 4);
        let scene = uploaded(&context, &gaussians);
        let mut renderer =
            reserved(&context, &Reservation { slots: 3, ..Reservation::new(900, 1, SIZE[0], SIZE[1]) });
        let scenes = [(&scene).into()];
        let cameras = [0.0, 1.0, 2.0].map(|turn| camera(turn, SIZE[0], SIZE[1]));
        let frames = [0; 3].map(|_| Commands::new(host));
        let staging = [0; 3].map(|_| Staging::new(host, 16 * PIXELS as u64));
        let expected = cameras.map(|camera| owned(&gaussians, &camera, &SETTINGS));
        for order in [[0, 1, 2], [2, 0, 1], [2, 1, 0]] {
            for slot in 0..3 {
                let recorded = frame_of(&scenes, &cameras[slot]);
                record(&mut renderer, (slot as u32, &frames[slot], &staging[slot]), &recorded);
            }
            for slot in order {
                frames[slot].submit();
            }
            frames.iter().for_each(|frame| frame.wait());
            for slot in 0..3 {
                assert_same(&staging[slot].read(), &expected[slot]);
                let report = report_of(&mut renderer, slot as u32);
                assert_eq!(report.visible, expected[slot].stats.visible);
                assert_eq!(report.instances_needed, expected[slot].stats.instances);
            }
        }
    });
}

/// The second frame in a command buffer writes memory that the first one reads. Synchronization validation checks
/// that it waits.
#[test]
fn frames_of_one_command_buffer_share_memory() {
    with_host(&options(), |host| {
        // Timestamps add barriers.
        let options = ContextOptions { timestamps: false, ..ContextOptions::default() };
        let context = guest_of(&host.foreign(), &options);
        let gaussians = cloud(900, 4);
        let scene = uploaded(&context, &gaussians);
        let wanted = Reservation { slots: 2, ..Reservation::new(900, 1, SIZE[0], SIZE[1]) };
        let mut renderer = reserved(&context, &both(wanted));
        let scenes = [(&scene).into()];
        let cameras = [0.0, 1.0].map(|turn| camera(turn, SIZE[0], SIZE[1]));
        let staging = [0; 2].map(|_| Staging::new(host, 16 * PIXELS as u64));
        let frame = Commands::new(host);
        let mut flights = [0; 2].map(|_| Flight::new(host, &context, SIZE));
        frame.begin();
        // Each camera's previous position is that of the other.
        for (slot, camera) in cameras.iter().enumerate() {
            let recorded = frame_of(&scenes, camera);
            let recorded = flights[slot].with(recorded, &cameras[1 - slot], [true; 2]);
            renderer.record(frame.adopt(&context), slot as u32, &recorded).expect("a recording");
        }
        flights.iter_mut().for_each(|flight| flight.record_read(&frame, [true; 2]));
        for (slot, staging) in (0..).zip(&staging) {
            copy_pixels(&mut renderer, slot, &frame, staging);
        }
        frame.finish();
        let alone = Flight::new(host, &context, SIZE);
        for (slot, flight) in flights.iter().enumerate() {
            let drawn = frame_of(&scenes, &cameras[slot]);
            rendered(host, &mut renderer, &alone.with(drawn, &cameras[1 - slot], [true; 2]));
            let expected = alone.now([true; 2]);
            assert!(expected.1.iter().any(|motion| *motion != [0; 2]));
            assert!(flight.read([true; 2]) == expected, "frame {slot} has others beside it");
        }
        for (camera, staging) in cameras.iter().zip(staging) {
            assert_same(&staging.read(), &owned(&gaussians, camera, &SETTINGS));
        }
        drop(renderer);
    });
}

/// Two slots are in flight with too little capacity while the third gets more.
#[test]
fn memory_grows_while_frames_fly() {
    with_guest(|host, context| {
        let (gaussians, view) = (cloud(900, 9), camera(0.2, SIZE[0], SIZE[1]));
        let scene = uploaded(&context, &gaussians);
        let mut renderer = Renderer::new(&context).expect("kernels");
        let small = Reservation { slots: 3, instances: 100, ..Reservation::new(900, 1, SIZE[0], SIZE[1]) };
        assert_error(renderer.grow(&small), "none are reserved that could grow");
        renderer.reserve(&small).expect("memory");
        let before = slot_bytes(&context);
        let scenes = [(&scene).into()];
        let recorded = frame_of(&scenes, &view);
        let frames = [0; 3].map(|_| Commands::new(host));
        let staging = [0; 3].map(|_| Staging::new(host, 16 * PIXELS as u64));
        let gate = Gate::closed(host);
        for (slot, frame) in (0..).zip(&frames[..2]) {
            frame.begin();
            gate.record_wait(frame.commands);
            let commands = frame.adopt(&context);
            renderer.record(commands, slot, &recorded).expect("a recording");
            frame.submit();
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
        record(&mut renderer, (2, &frames[2], &staging[2]), &recorded);
        frames[2].submit();
        assert!([0, 2].iter().all(|&slot| !renderer.slot_finished(slot).expect("a status")));
        gate.open();
        frames.iter().for_each(|frame| frame.wait());

        let expected = owned(&gaussians, &view, &SETTINGS);
        assert_same(&staging[2].read(), &expected);
        let reports = [0, 1, 2].map(|slot| report_of(&mut renderer, slot));
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
        record(&mut renderer, (1, &frames[1], &staging[1]), &recorded);
        frames[1].submit();
        frames[1].wait();
        assert_same(&staging[1].read(), &expected);
        let grown = slot_bytes(&context);
        renderer.reserve(&enough).expect("memory");
        assert_eq!(slot_bytes(&context), grown, "nothing is left of the old memory");
    });
}

struct HostBlock<'a>(Own<'a, (vk::Buffer, vk::DeviceMemory)>);

impl<'a> HostBlock<'a> {
    fn new(host: &'a Host, bytes: u64) -> Self {
        let usage = vk::BufferUsageFlags::STORAGE_BUFFER
            | vk::BufferUsageFlags::UNIFORM_BUFFER
            | vk::BufferUsageFlags::INDIRECT_BUFFER
            | vk::BufferUsageFlags::TRANSFER_SRC
            | vk::BufferUsageFlags::TRANSFER_DST;
        let info = vk::BufferCreateInfo::default().size(bytes).usage(usage);
        // SAFETY: a valid create info; the buffer is bound once to memory of its own.
        let block = unsafe {
            let raw = host.device.create_buffer(&info, None).expect("a buffer");
            let needs = host.device.get_buffer_memory_requirements(raw);
            let memory = host.allocate(needs, vk::MemoryPropertyFlags::DEVICE_LOCAL).expect("memory");
            host.device.bind_buffer_memory(raw, memory, 0).expect("bound");
            (raw, memory)
        };
        // SAFETY: nothing uses it any more when it is dropped.
        let destroy = |(raw, memory), host: &Host| unsafe {
            host.device.destroy_buffer(raw, None);
            host.device.free_memory(memory, None);
        };
        Self(Own::of(host, block, destroy))
    }

    fn adopt(&self, context: &Context, offset: u64, bytes: u64) -> Buffer {
        // SAFETY: the buffer is as `new` has made it, and outlives the renderer.
        unsafe { Buffer::adopt(context, "host's frames", self.0.0, offset, bytes) }.expect("adopted")
    }
}

#[test]
fn a_hosts_block_holds_all_slots() {
    with_guest(|host, context| {
        let gaussians = cloud(900, 4);
        let scene = uploaded(&context, &gaussians);
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
        assert_error(renderer.reserve_in(&small, &block.adopt(&other, 256, bytes[0])), "another context");
        renderer.reserve_in(&small, &parts[0]).expect("room");
        assert_eq!(slot_bytes(&context), 0, "all of it is the host's");

        let placed = [Placed::from(&scene)];
        let draw =
            |renderer: &mut Renderer, view: &Camera| rendered(host, renderer, &frame_of(&placed, view));
        let view = camera(0.4, SIZE[0], SIZE[1]);
        draw(&mut renderer, &view);
        assert!(report_of(&mut renderer, 0).overflow);
        renderer.grow_in(&large, &parts[1]).expect("room");
        for turn in [0.4, 1.4] {
            let view = camera(turn, SIZE[0], SIZE[1]);
            assert_same(&draw(&mut renderer, &view), &owned(&gaussians, &view, &SETTINGS));
        }
        assert_eq!(slot_bytes(&context), 0);
        drop((renderer, parts));
    });
}
