//! The guide's example of a guest in Rust: its code compiles and runs as printed.

use crate::host::{Host, HostOptions, InFlight};
use crate::memory::{HostTexture, Use};
use crate::scenes::depth_image;
use crate::stage::{cloud, guest, options, read_texture, with_host};
use ashsplat::glam::camera::rh::{proj::vulkan, view::look_at_mat4};
use ashsplat::glam::{Mat3, Vec3};
use ashsplat::scene::ClipY;
use ashsplat::vk::ImageUse;

include!("guides_guest/guest.rs");

const CLEARED: Use = (
    vk::ImageLayout::TRANSFER_DST_OPTIMAL,
    vk::PipelineStageFlags2::ALL_TRANSFER,
    vk::AccessFlags2::TRANSFER_WRITE,
);
const UNUSED: Use = (vk::ImageLayout::UNDEFINED, vk::PipelineStageFlags2::NONE, vk::AccessFlags2::NONE);

/// The engine's images, and the last use of each.
struct Screen {
    color: HostTexture,
    depth: HostTexture,
    last: [Use; 2],
}

impl Screen {
    fn new(host: &Host, size: [u32; 2]) -> Self {
        let usage = vk::ImageUsageFlags::STORAGE
            | vk::ImageUsageFlags::TRANSFER_SRC
            | vk::ImageUsageFlags::TRANSFER_DST;
        let color = HostTexture::new(host, vk::Format::R8G8B8A8_UNORM, usage, size).expect("an image");
        // The far plane of reversed depth.
        let (depth, written) = depth_image(host, size, 0.0);
        Self { color, depth, last: [UNUSED, (written.layout, written.stages, written.accesses)] }
    }

    fn adopted(&self, context: &Context) -> [Image; 2] {
        let with = [(&self.color, ImageUse::Target), (&self.depth, ImageUse::Occluder)];
        // SAFETY: the descriptions match the images, which are destroyed after the slots that use the views.
        with.map(|(texture, purpose)| unsafe {
            Image::adopt(context, "screen", &texture.foreign(), purpose).expect("adopted")
        })
    }

    /// Stands in for the engine's drawing: clears to a colour.
    fn clear(&mut self, host: &Host, commands: vk::CommandBuffer) -> [ImageState; 2] {
        self.color.barrier(host, commands, self.last[0], CLEARED);
        let color = vk::ClearColorValue { float32: [0.25, 0.5, 0.125, 1.0] };
        let range = vk::ImageSubresourceRange::default()
            .aspect_mask(vk::ImageAspectFlags::COLOR)
            .level_count(1)
            .layer_count(1);
        // SAFETY: the command buffer is being recorded; the image is in that layout.
        unsafe {
            host.device.cmd_clear_color_image(commands, self.color.image, CLEARED.0, &color, &[range]);
        }
        [CLEARED, self.last[1]].map(|(layout, stages, accesses)| ImageState { layout, stages, accesses })
    }

    fn left(&mut self, release: &Release) {
        for (last, state) in self.last.iter_mut().zip([release.color, release.occluder]) {
            let state = state.expect("the frame uses it");
            *last = (state.layout, state.stages, state.accesses);
        }
    }

    fn destroy(self, host: &Host) {
        self.color.destroy(host);
        self.depth.destroy(host);
    }
}

fn view([width, height]: [u32; 2]) -> HostView {
    HostView {
        view_from_world: look_at_mat4(Vec3::new(0.5, 1.0, 4.0), Vec3::ZERO, Vec3::Y),
        clip_from_view: vulkan::perspective_infinite_reverse(0.7, width as f32 / height as f32, 0.1),
        clip_y: ClipY::Down,
        width,
        height,
    }
}

fn turned(angle: f32) -> Pose {
    Pose { world_from_object: Mat3::from_rotation_y(angle), ..Pose::IDENTITY }
}

/// Records and submits a frame of the engine.
fn frame(
    host: &Host,
    guest: &mut Guest,
    screen: &mut Screen,
    (slot, frame): (u32, &InFlight),
    size: [u32; 2],
) {
    frame.begin(host).expect("recording");
    let drawn = screen.clear(host, frame.commands);
    let release = guest.draw(frame.commands, slot, &view(size), drawn).expect("a recording");
    screen.left(&release.expect("there are scenes"));
    frame.submit(host).expect("a submission");
}

#[test]
fn the_guest_is_the_guides() {
    let guide = include_str!("../../engine/guide/embedding.md");
    let code = include_str!("guides_guest/guest.rs");
    assert!(guide.contains(&format!("```no_run\n{code}```\n")), "the guide's guest is another one");
}

/// Three frames in flight, while scenes come and go, the window is resized and a frame overflows. The last picture
/// has the bits of a guest without these changes.
#[test]
fn the_guides_guest_draws_through_changes() {
    with_host(&options(), |host| {
        let context = guest(host);
        let [small, large] = [[96, 64], [136, 88]];
        let mut screen = Screen::new(host, small);
        let mut size = small;
        let mut own = Guest::new(&context, 3, screen.adopted(&context)).expect("a guest");
        let few = Reservation { instances: 16, ..own.reserved };
        own.grow(few).expect("less memory");
        let frames = [0; 3].map(|_| InFlight::new(host).expect("a command buffer"));
        let mut old: Option<(usize, Screen)> = None;
        own.add(&cloud(500, 1), turned(0.2)).expect("a scene");
        for number in 0..14 {
            let slot = number % 3;
            if number >= 3 {
                frames[slot].wait(host).expect("done");
            }
            own.finish(slot as u32).expect("finished");
            if let Some((_, gone)) = old.take_if(|(resized, _)| number >= *resized + 3) {
                gone.destroy(host);
            }
            match number {
                // More scenes than reserved at first.
                2 => (0..17).for_each(|seed| own.add(&cloud(5, seed), turned(0.5)).expect("a scene")),
                3 => (0..17).for_each(|_| own.remove(1)),
                4 => own.add(&cloud(700, 2), turned(1.0)).expect("a scene"),
                6 => {
                    let new = Screen::new(host, large);
                    own.resize(new.adopted(&context)).expect("room");
                    old = Some((number, std::mem::replace(&mut screen, new)));
                    size = large;
                }
                9 => own.remove(0),
                _ => (),
            }
            frame(host, &mut own, &mut screen, (slot as u32, &frames[slot]), size);
        }
        assert!(own.reserved.instances > 1000, "the first frames had too little room");
        (0..3).for_each(|slot| {
            frames[slot].wait(host).expect("done");
            own.finish(slot as u32).expect("finished");
        });
        drop(own);
        let picture = read_texture(host, &screen.color, screen.last[0]);
        screen.last[0] = UNUSED;
        let mut alone = Guest::new(&context, 1, screen.adopted(&context)).expect("a guest");
        alone.add(&cloud(700, 2), turned(1.0)).expect("a scene");
        frame(host, &mut alone, &mut screen, (0, &frames[0]), size);
        frames[0].wait(host).expect("done");
        alone.finish(0).expect("finished");
        drop(alone);
        let expected = read_texture(host, &screen.color, screen.last[0]);
        assert!(picture == expected, "other bits");
        let background = &picture[..4];
        assert!(
            picture.chunks(4).filter(|texel| *texel != background).count() > 2000,
            "hardly anything drawn"
        );
        frames.into_iter().for_each(|frame| frame.destroy(host));
        screen.destroy(host);
    });
}

/// Prints CPU microseconds of recording two scenes over an image and behind a host's depth: median and least.
#[test]
#[ignore = "prints numbers of the guide"]
fn costs() {
    for push_descriptors in [true, false] {
        with_host(&HostOptions { push_descriptors, ..HostOptions::default() }, |host| {
            let context = crate::cost::shipped(host, false);
            let size = [96, 64];
            let mut screen = Screen::new(host, size);
            let mut own = Guest::new(&context, 2, screen.adopted(&context)).expect("a guest");
            for seed in [1, 2] {
                own.add(&cloud(8, seed), turned(0.2)).expect("a scene");
            }
            let frames = [0; 2].map(|_| InFlight::new(host).expect("a command buffer"));
            let mut times = Vec::new();
            for number in 0..204 {
                let (slot, frame) = (number % 2, &frames[number % 2]);
                own.finish(slot as u32).expect("finished");
                frame.begin(host).expect("recording");
                let drawn = screen.clear(host, frame.commands);
                let start = std::time::Instant::now();
                let release = own.draw(frame.commands, slot as u32, &view(size), drawn);
                let time = start.elapsed().as_secs_f64() * 1e6;
                screen.left(&release.expect("a recording").expect("there are scenes"));
                frame.submit(host).expect("a submission");
                // A CPU device would slow down the next recording.
                frame.wait(host).expect("done");
                times.push(time);
            }
            times.drain(..4);
            times.sort_by(f64::total_cmp);
            println!("push descriptors {push_descriptors}: {:.1} ({:.1})", times[times.len() / 2], times[0]);
            frames.into_iter().for_each(|frame| frame.destroy(host));
            drop(own);
            screen.destroy(host);
        });
    }
}
