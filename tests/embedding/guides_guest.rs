//! The guide's example of a guest in Rust: its code compiles and runs as printed.

use crate::stage::*;
use ashsplat::glam::camera::rh::{proj::vulkan, view::look_at_mat4};
use ashsplat::scene::ClipY;

include!("guides_guest/guest.rs");

/// The engine's images, and the last use of each.
struct Screen<'a> {
    color: Texture<'a>,
    depth: Texture<'a>,
    last: [ImageState; 2],
}

impl<'a> Screen<'a> {
    fn new(host: &'a Host, size: [u32; 2]) -> Self {
        let copies = vk::ImageUsageFlags::TRANSFER_SRC | vk::ImageUsageFlags::TRANSFER_DST;
        let new = |format, usage| Texture::new(host, format, usage | copies, size);
        let color = new(vk::Format::R8G8B8A8_UNORM, vk::ImageUsageFlags::STORAGE);
        let depth = new(vk::Format::D32_SFLOAT, vk::ImageUsageFlags::SAMPLED);
        // The far plane of reversed depth.
        depth.write(&vec![0.0f32; (size[0] * size[1]) as usize]);
        Self { color, depth, last: [ImageState::UNDEFINED, COPIED] }
    }

    fn adopted(&self, context: &Context) -> [Image; 2] {
        let color = self.color.adopt(context, "screen", ImageUse::Target);
        [color, self.depth.adopt(context, "screen", ImageUse::Occluder)]
    }

    /// Stands in for the engine's drawing: clears to a colour.
    fn clear(&mut self, commands: vk::CommandBuffer) -> [ImageState; 2] {
        self.color.clear(commands, self.last[0], [0.25, 0.5, 0.125, 1.0]);
        [COPIED, self.last[1]]
    }

    fn left(&mut self, release: &Release) {
        self.last = [release.color, release.occluder].map(|state| state.expect("the frame uses it"));
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
fn frame(guest: &mut Guest, screen: &mut Screen<'_>, (slot, frame): (u32, &Commands<'_>), size: [u32; 2]) {
    frame.begin();
    let drawn = screen.clear(frame.commands);
    let release = guest.draw(frame.commands, slot, &view(size), drawn).expect("a recording");
    screen.left(&release.expect("there are scenes"));
    frame.submit();
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
    with_guest(|host, context| {
        let [small, large] = [[96, 64], [136, 88]];
        let mut screen = Screen::new(host, small);
        let mut size = small;
        let mut own = Guest::new(&context, 3, screen.adopted(&context)).expect("a guest");
        let few = Reservation { instances: 16, ..own.reserved };
        own.grow(few).expect("less memory");
        let frames = [0; 3].map(|_| Commands::new(host));
        let mut old: Option<(usize, Screen)> = None;
        own.add(&cloud(500, 1), turned(0.2)).expect("a scene");
        for number in 0..14 {
            let slot = number % 3;
            if number >= 3 {
                frames[slot].wait();
            }
            own.finish(slot as u32).expect("finished");
            drop(old.take_if(|(resized, _)| number >= *resized + 3));
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
            frame(&mut own, &mut screen, (slot as u32, &frames[slot]), size);
        }
        assert!(own.reserved.instances > 1000, "the first frames had too little room");
        (0..3).for_each(|slot| {
            frames[slot].wait();
            own.finish(slot as u32).expect("finished");
        });
        drop(own);
        let picture: Vec<u8> = screen.color.read(screen.last[0]);
        screen.last[0] = ImageState::UNDEFINED;
        let mut alone = Guest::new(&context, 1, screen.adopted(&context)).expect("a guest");
        alone.add(&cloud(700, 2), turned(1.0)).expect("a scene");
        frame(&mut alone, &mut screen, (0, &frames[0]), size);
        frames[0].wait();
        alone.finish(0).expect("finished");
        drop(alone);
        let expected: Vec<u8> = screen.color.read(screen.last[0]);
        assert!(picture == expected, "other bits");
        let background = &picture[..4];
        assert!(picture.chunks(4).filter(|texel| *texel != background).count() > 2000, "little is drawn");
    });
}
