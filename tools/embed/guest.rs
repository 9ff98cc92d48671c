//! The part that a host engine writes to draw splats. The steps are numbered as in the guide's chapter `embedding`.

use super::allocator::Adapter;
use super::host::{Host, HostOptions, InFlight, Result};
use super::memory::{HostBuffer, HostTexture, Use};
use super::passes::{
    COLOR_WRITTEN, Cube, CubePass, DEPTH_WRITTEN, EMPTY, SAMPLED, SplatDepth, Tonemap, UNUSED,
};
use ashsplat::ash::vk;
use ashsplat::glam::camera::rh::{proj::vulkan, view::look_at_mat4};
use ashsplat::glam::{Mat3, Mat4, Vec3};
use ashsplat::scene::{ClipY, DepthMapping, HostView, Pose};
use ashsplat::vk::{Context, ContextOptions, ForeignDevice, Image, ImageState, ImageUse};
use ashsplat::{
    Background, ColorEncoding, DepthTarget, DeviceScene, Gaussians, HostImage, Occluder, Placed,
    RecordedFrame, Release, RenderSettings, Renderer, Reservation, Target,
};
use std::path::Path;
use std::sync::Arc;

pub const SIZE: [u32; 2] = [480, 360];
const FRAMES_IN_FLIGHT: u32 = 2;
/// Linear light: 26, 31 and 41 of 255 on a display.
const BACKGROUND: [f32; 4] = [0.010330, 0.013702, 0.022174, 1.0];
const PIXEL_BYTES: u64 = 4 * SIZE[0] as u64 * SIZE[1] as u64;

#[derive(Clone, Copy)]
pub struct Picture {
    pub name: &'static str,
    /// Rotation of the crate, radians.
    pub angle: f32,
    /// True for reversed depth with an infinite far plane, usual in engines today; false for depth from near to far.
    pub reversed_depth: bool,
    /// True if a second scene is drawn.
    pub second: bool,
    /// Encoding that the guest writes. The host lights and blends in linear light; any other encoding makes splats look
    /// washed out.
    pub encoding: ColorEncoding,
}

const TURNED: Picture = Picture {
    name: "turned",
    angle: 2.3,
    reversed_depth: true,
    second: true,
    encoding: ColorEncoding::LINEAR,
};

pub const PICTURES: [Picture; 5] = [
    Picture { name: "standard", angle: 0.5, reversed_depth: false, second: false, ..TURNED },
    Picture { name: "reversed", angle: 0.5, second: false, ..TURNED },
    Picture { name: "two_scenes", angle: 1.1, ..TURNED },
    TURNED,
    // A common mistake: an encoding that the host does not blend in.
    Picture { name: "washed_out", encoding: ColorEncoding::AsTrained, ..TURNED },
];

/// The engine with its guest.
struct Engine {
    /// Command buffers, and buffers in which the host reads their pictures.
    frames: Vec<(InFlight, HostBuffer)>,
    cube: Cube,
    splat_depth: SplatDepth,
    tonemap: Tonemap,
    /// Picture in linear light, with a larger range than a display's.
    color: HostTexture,
    depth: HostTexture,
    /// Expected depth of the splats.
    expected: HostTexture,
    /// Picture as displayed.
    display: HostTexture,
    /// Last uses of colour, depth and display in the previous frame.
    last: [Use; 3],
    guest: Guest,
}

struct Guest {
    renderer: Renderer,
    color: Image,
    depth: Image,
    expected: Image,
    ring: DeviceScene,
    ball: DeviceScene,
    allocator: Arc<Adapter>,
}

impl Engine {
    fn new(host: &Host) -> Result<Self> {
        type Usage = vk::ImageUsageFlags;
        let image = |format, usage| HostTexture::new(host, format, usage, SIZE);
        // The guest writes into colour and expected depth (STORAGE), and reads the depth (SAMPLED).
        let color_usage = Usage::COLOR_ATTACHMENT | Usage::SAMPLED | Usage::STORAGE;
        let color = image(vk::Format::R16G16B16A16_SFLOAT, color_usage)?;
        let depth = image(vk::Format::D32_SFLOAT, Usage::DEPTH_STENCIL_ATTACHMENT | Usage::SAMPLED)?;
        let expected = image(vk::Format::R32_SFLOAT, Usage::STORAGE | Usage::SAMPLED)?;
        let display = image(vk::Format::R8G8B8A8_SRGB, Usage::COLOR_ATTACHMENT | Usage::TRANSFER_SRC)?;
        let frame = |_| Ok((InFlight::new(host)?, HostBuffer::new(host, PIXEL_BYTES)?));
        let frames = (0..FRAMES_IN_FLIGHT).map(frame).collect::<Result<_>>()?;
        let cube = Cube::new(host, color.format, depth.format)?;
        let tonemap = Tonemap::new(host, &color, display.format)?;
        let splat_depth = SplatDepth::new(host, &expected, depth.format)?;
        let guest = Guest::new(host, [&color, &depth, &expected])?;
        let last = [UNUSED; 3];
        Ok(Self { frames, cube, splat_depth, tonemap, guest, color, depth, expected, display, last })
    }

    /// Records and submits a frame: the engine's own pass, the splats, and the copy for the host, all in one command buffer.
    /// Several frames are in flight, and use the same images in turn.
    fn draw(&mut self, host: &Host, number: usize, picture: &Picture) -> Result<()> {
        let slot = number % self.frames.len();
        let (frame, pixels) = &self.frames[slot];
        let commands = frame.commands;
        frame.begin(host)?;
        let view = view(picture);
        let world_from_object = Mat4::from_rotation_y(picture.angle) * Mat4::from_rotation_x(0.4);
        let clip_from_object = view.clip_from_view * view.view_from_world * world_from_object;
        self.cube.record(
            host,
            commands,
            &CubePass {
                color: &self.color,
                depth: &self.depth,
                last: [self.last[0], self.last[1]],
                background: BACKGROUND,
                clip_from_object: clip_from_object.to_cols_array(),
                reversed_depth: picture.reversed_depth,
            },
        );
        let (release, mapping) = self.guest.record(commands, slot as u32, picture, &view)?;
        // 7. The release says what to wait for, and the images' layouts. Two passes wait here: the last one of this frame,
        // and the first one of the next, which overwrites the depth that the guest reads.
        let color = release.color.map(uses).ok_or("the frame has a target")?;
        let depth = release.occluder.map(uses).ok_or("the frame has a depth")?;
        let expected = release.depth.map(uses).ok_or("the frame has an expected depth")?;
        // From here on, splats also hide later passes.
        let images = [&self.expected, &self.depth];
        let [_, depth] = self.splat_depth.record(host, commands, images, [expected, depth], &mapping);
        let images = [&self.color, &self.display];
        let [color, display] = self.tonemap.record(host, commands, images, [color, self.last[2]]);
        let display = self.display.record_read(host, commands, display, pixels);
        self.last = [color, depth, display];
        frame.submit(host)
    }

    /// Draws all pictures in turn. Returns a report line for each.
    fn pictures(&mut self, host: &Host, folder: &Path) -> Result<Vec<String>> {
        let mut report = Vec::new();
        let in_flight = self.frames.len();
        for number in 0..PICTURES.len() + in_flight {
            if number >= in_flight {
                report.push(self.finish(host, number - in_flight, folder)?);
            }
            if let Some(picture) = PICTURES.get(number) {
                self.draw(host, number, picture)?;
            }
        }
        report.push(format!("{} pieces of memory of the host's allocator", self.guest.allocator.pieces()));
        Ok(report)
    }

    /// Drops the guest before the images and the device that it uses.
    fn destroy(self, host: &Host) {
        let Self { frames, cube, splat_depth, tonemap, color, depth, expected, display, guest, .. } = self;
        drop(guest);
        for (frame, pixels) in frames {
            frame.destroy(host);
            pixels.destroy(host);
        }
        cube.destroy(host);
        splat_depth.destroy(host);
        tonemap.destroy(host);
        [color, depth, expected, display].into_iter().for_each(|image| image.destroy(host));
    }

    /// Waits for a frame and writes its picture. Returns its report line.
    fn finish(&mut self, host: &Host, number: usize, folder: &Path) -> Result<String> {
        let slot = number % self.frames.len();
        let (frame, pixels) = &self.frames[slot];
        frame.wait(host)?;
        let bytes = pixels.read(host, PIXEL_BYTES as usize)?;
        let path = folder.join(format!("embed_{}.png", PICTURES[number].name));
        image::save_buffer(&path, &bytes, SIZE[0], SIZE[1], image::ColorType::Rgba8)?;
        // 8. The counts of the frame, once it has finished. They also say if its reservation was too small.
        let made = self.guest.renderer.slot_report(slot as u32)?.ok_or("the frame has finished")?;
        Ok(format!(
            "{}: {} of {} Gaussians visible, {} of {} instances{}",
            path.display(),
            made.visible,
            made.gaussians,
            made.instances_needed,
            made.instance_capacity,
            if made.overflow { ", too few" } else { "" }
        ))
    }
}

impl Guest {
    fn new(host: &Host, [color, depth, expected]: [&HostTexture; 3]) -> Result<Self> {
        // 2. A context on the host's device, with memory from the host's allocator. It destroys nothing of the host's.
        let allocator = Arc::new(Adapter::new(host)?);
        let foreign = ForeignDevice { allocator: Some(allocator.clone()), ..host.foreign() };
        // SAFETY: the handles are alive and outlive the guest (`pictures` drops it first); `Host::foreign` says what was enabled;
        // only this thread uses the queue.
        let context = unsafe { Context::from_foreign(&foreign, &ContextOptions::default())? };
        // 3. Scenes, and views of the host's images.
        let ring = DeviceScene::upload(&context, &ring(), 0)?;
        let ball = DeviceScene::upload(&context, &ball(), 0)?;
        let adopt = |name, image: &HostTexture, purpose| {
            // SAFETY: the images are the host's, were created as described, and outlive the guest.
            unsafe { Image::adopt(&context, name, &image.foreign(), purpose) }
        };
        let color = adopt("picture", color, ImageUse::Target)?;
        let depth = adopt("picture's depth", depth, ImageUse::Occluder)?;
        let expected = adopt("expected depth", expected, ImageUse::Depth)?;
        // 4. Everything that frames will need is built and allocated here.
        let mut renderer = Renderer::new(&context)?;
        renderer.reserve(&Reservation {
            slots: FRAMES_IN_FLIGHT,
            scenes: 2,
            occlusion: true,
            expected_depth: true,
            images_only: true,
            ..Reservation::new(ring.count() + ball.count(), 1, SIZE[0], SIZE[1])
        })?;
        Ok(Self { renderer, color, depth, expected, ring, ball, allocator })
    }

    fn record(
        &mut self,
        commands: vk::CommandBuffer,
        slot: u32,
        picture: &Picture,
        view: &HostView,
    ) -> Result<(Release, DepthMapping)> {
        // 5. The host's matrices define its conventions, and how to read its depth.
        let (camera, mapping) = view.camera()?;
        // SAFETY: recording state, outside of the pass; submitted once, and waited for before the slot is used again.
        let commands = unsafe { self.renderer.context().adopt_commands(commands)? };
        let turned = Mat3::from_rotation_z(picture.angle);
        let pose = Pose { world_from_object: turned, translation: Vec3::new(0.75, 0.55, 0.75), scale: 1.0 };
        let scenes = [Placed::from(&self.ring), Placed::at(&self.ball, pose)];
        let scenes = if picture.second { &scenes[..] } else { &scenes[..1] };
        let settings = RenderSettings::default();
        // 6. The frame, composed over the host's picture, hidden where the host's depth is nearer.
        let (to, behind) = (used(&self.color, COLOR_WRITTEN), Background::Image);
        let target = Target::Image { to, behind, encoding: picture.encoding };
        let occluder = Some(Occluder { depth: used(&self.depth, DEPTH_WRITTEN), mapping });
        // The previous frame's depth pass has sampled it.
        let to = used(&self.expected, (UNUSED.0, SAMPLED.1, SAMPLED.2));
        let depth = Some(DepthTarget { to, min_weight: 0.5, empty: EMPTY });
        let frame =
            RecordedFrame { target, occluder, depth, ..RecordedFrame::new(scenes, &camera, &settings) };
        Ok((self.renderer.record(commands, slot, &frame)?, mapping))
    }
}

fn used(image: &Image, (layout, stages, accesses): Use) -> HostImage<'_> {
    HostImage { image, from: ImageState { layout, stages, accesses }, offset: [0; 2] }
}

fn uses(state: ImageState) -> Use {
    (state.layout, state.stages, state.accesses)
}

/// Draws the pictures into a folder, each as "embed_NAME.png". Returns a report line for each.
pub fn pictures(folder: &Path, options: &HostOptions) -> Result<Vec<String>> {
    // 1. The host creates its device and enables what `Context::requirements()` lists.
    let host = Host::new(options)?;
    let report = draw(&host, folder);
    let messages = host.destroy();
    if let Some(first) = messages.first() {
        return Err(format!("{} validation messages: {first}", messages.len()).into());
    }
    let mut report = report?;
    report.push("0 validation messages".into());
    Ok(report)
}

fn draw(host: &Host, folder: &Path) -> Result<Vec<String>> {
    let mut engine = Engine::new(host)?;
    let report = engine.pictures(host, folder);
    // Waits even after a failure, because the guest and its images may be dropped only when the device is idle.
    host.wait()?;
    engine.destroy(host);
    report
}

/// The engine's matrices: y up in the world, right-handed, Vulkan's clip space.
fn view(picture: &Picture) -> HostView {
    let aspect = SIZE[0] as f32 / SIZE[1] as f32;
    let fov_y = 0.9;
    let clip_from_view = match picture.reversed_depth {
        true => vulkan::perspective_infinite_reverse(fov_y, aspect, 0.1),
        false => vulkan::perspective(fov_y, aspect, 0.1, 50.0),
    };
    HostView {
        view_from_world: look_at_mat4(Vec3::new(0.4, 1.1, 2.6), Vec3::ZERO, Vec3::Y),
        clip_from_view,
        clip_y: ClipY::Down,
        width: SIZE[0],
        height: SIZE[1],
    }
}

/// Gaussians around the crate, some in front of it and some behind.
pub fn ring() -> Gaussians {
    let mut ring = Gaussians { sh_degree: 1, ..Gaussians::default() };
    for i in 0..2400 {
        let angle = i as f32 * 0.0261799;
        let turn = i as f32 * 2.399963;
        let width = 0.16 * ((i * 7919 % 997) as f32 / 997.0).sqrt();
        let radius = 1.0 + width * turn.cos();
        let mean = [radius * angle.cos(), 0.28 * angle.cos() + width * turn.sin(), radius * angle.sin()];
        let color =
            [0.5 + 0.5 * angle.cos(), 0.5 + 0.5 * (angle + 2.1).cos(), 0.5 + 0.5 * (angle + 4.2).cos()];
        push(&mut ring, mean, 0.022, 1.8, color);
    }
    ring
}

/// A ball of Gaussians around its own origin, one half blue, one yellow.
fn ball() -> Gaussians {
    let mut ball = Gaussians { sh_degree: 1, ..Gaussians::default() };
    for i in 0..900 {
        let y = 1.0 - 2.0 * (i as f32 + 0.5) / 900.0;
        let (turn, radius) = (i as f32 * 2.399963, (1.0 - y * y).sqrt());
        let mean = [radius * turn.cos(), y, radius * turn.sin()].map(|x| 0.22 * x);
        let color = if mean[1] > 0.0 { [0.98, 0.85, 0.2] } else { [0.15, 0.35, 0.9] };
        push(&mut ball, mean, 0.018, 3.0, color);
    }
    ball
}

fn push(to: &mut Gaussians, mean: [f32; 3], scale: f32, opacity_logit: f32, color: [f32; 3]) {
    to.means.push(mean);
    to.quats.push([1.0, 0.0, 0.0, 0.0]);
    to.log_scales.push([scale.ln(); 3]);
    to.opacity_logits.push(opacity_logit);
    // Degree 0 holds the colour; degree 1 has no effect here.
    to.sh.push(color.map(|c| (c - 0.5) / 0.282_094_8));
    to.sh.extend([[0.0; 3]; 3]);
}
