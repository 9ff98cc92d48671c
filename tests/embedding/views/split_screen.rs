//! Two players side by side, with every output of a frame.

use super::{SIZE, render_views};
use crate::auxiliary::truth::{Screens, WRITTEN};
use crate::cost::shipped;
use crate::counting::allocations;
use crate::host::{Host, HostOptions, InFlight};
use crate::memory::{HostBuffer, HostTexture};
use crate::stage::{adopt, camera, cloud, guest, options, with_host};
use ashsplat::ash::vk;
use ashsplat::scene::{CutOut, DepthMapping, Inside, Pose, Volume};
use ashsplat::vk::{Image, ImageState, ImageUse};
use ashsplat::{
    Background, ColorEncoding, DepthTarget, DeviceScene, HostImage, MotionTarget, Occluder, PickTarget,
    Placed, RecordedFrame, Release, RenderSettings, Renderer, Reservation, SceneSettings, Target, Update,
};
use glam::{Mat3, Vec3};

/// Images of a split screen for both players: colours, depths, occluder, picks and motion.
struct Split<'a> {
    host: &'a Host,
    textures: [HostTexture; 3],
    images: [Image; 3],
    beside: Screens<'a>,
}

const BOTH: [u32; 2] = [2 * SIZE[0], SIZE[1]];

impl<'a> Split<'a> {
    fn new(host: &'a Host, renderer: &Renderer) -> Self {
        let context = renderer.context();
        let (storage, copied) = (vk::ImageUsageFlags::STORAGE, vk::ImageUsageFlags::TRANSFER_SRC);
        let sampled = vk::ImageUsageFlags::SAMPLED | vk::ImageUsageFlags::TRANSFER_DST;
        let new = |format, usage| HostTexture::new(host, format, usage, BOTH).expect("an image");
        let textures = [
            new(vk::Format::R32G32B32A32_SFLOAT, storage | copied),
            new(vk::Format::R32_SFLOAT, storage | copied),
            new(vk::Format::R32_SFLOAT, sampled),
        ];
        let view = |texture: &HostTexture, purpose| {
            // SAFETY: the descriptions match the images, which outlive the views.
            unsafe { Image::adopt(context, "split", &texture.foreign(), purpose) }.expect("adopted")
        };
        let images = [
            view(&textures[0], ImageUse::Target),
            view(&textures[1], ImageUse::Depth),
            view(&textures[2], ImageUse::Occluder),
        ];
        let split = Self { host, textures, images, beside: Screens::new(host, context, BOTH) };
        split.write_depth();
        split
    }

    /// Writes the host's depth: z from 3 to 5 along the rows.
    fn write_depth(&self) {
        let depths: Vec<f32> =
            (0..BOTH[0] * BOTH[1]).map(|i| 1.0 / (3.0 + 2.0 * (i % 59) as f32 / 59.0)).collect();
        let bytes: &[u8] = bytemuck::cast_slice(&depths);
        let staging = HostBuffer::new(self.host, bytes.len() as u64).expect("memory");
        staging.write(self.host, bytes).expect("written");
        let (texture, to) = (&self.textures[2], Self::depth_use());
        let copied = self.host.run(|commands| {
            let none = (vk::ImageLayout::UNDEFINED, to.stages, vk::AccessFlags2::NONE);
            texture.barrier(self.host, commands, none, (to.layout, to.stages, to.accesses));
            // SAFETY: recording state; the image has the texels of the buffer.
            unsafe {
                let region = [texture.region()];
                self.host.device.cmd_copy_buffer_to_image(
                    commands,
                    staging.raw,
                    texture.image,
                    to.layout,
                    &region,
                );
            }
            Ok(())
        });
        copied.expect("copied");
        staging.destroy(self.host);
    }

    fn depth_use() -> ImageState {
        ImageState {
            layout: vk::ImageLayout::TRANSFER_DST_OPTIMAL,
            stages: vk::PipelineStageFlags2::ALL_TRANSFER,
            accesses: vk::AccessFlags2::TRANSFER_WRITE,
        }
    }

    /// A frame with every output into a player's part. `used`: release of a previous recording.
    fn frame<'b>(
        &'b self,
        frame: RecordedFrame<'b>,
        player: u32,
        used: Option<&Release>,
    ) -> RecordedFrame<'b> {
        let to = |image, from: Option<ImageState>| HostImage {
            image,
            from: from.unwrap_or(ImageState::UNDEFINED),
            offset: [player * SIZE[0], 0],
        };
        let hidden = to(&self.images[2], used.map_or(Some(Self::depth_use()), |used| used.occluder));
        let mapping = DepthMapping { scale: 1.0, offset: 0.0, clear_value: 0.0, linear: false };
        let behind = Background::Color([0.2, 0.3, 0.4]);
        RecordedFrame {
            target: Target::Image {
                to: to(&self.images[0], used.and_then(|used| used.color)),
                behind,
                encoding: ColorEncoding::AsTrained,
            },
            occluder: Some(Occluder { depth: hidden, mapping }),
            depth: Some(DepthTarget {
                to: to(&self.images[1], used.and_then(|used| used.depth)),
                min_weight: 0.5,
                empty: 0.0,
            }),
            pick: Some(PickTarget { to: to(&self.beside.views[0], used.and_then(|used| used.pick)) }),
            motion: Some(MotionTarget {
                to: to(&self.beside.views[1], used.and_then(|used| used.motion)),
                previous_camera: frame.camera,
                min_weight: 0.1,
                empty: Some([0.0; 2]),
            }),
            ..frame
        }
    }

    /// State of the images after they were read.
    fn after_read(release: &Release) -> Release {
        let mut after = *release;
        let read = ImageState {
            layout: vk::ImageLayout::TRANSFER_SRC_OPTIMAL,
            stages: vk::PipelineStageFlags2::ALL_TRANSFER,
            accesses: vk::AccessFlags2::NONE,
        };
        (after.color, after.depth, after.pick, after.motion) =
            (Some(read), Some(read), Some(read), Some(read));
        after
    }

    /// Reads all outputs.
    fn read(&self) -> [Vec<u32>; 4] {
        let from = (WRITTEN.layout, WRITTEN.stages, WRITTEN.accesses);
        let texels = |texture: &HostTexture, words: usize| -> Vec<u32> {
            let bytes = 4 * words * (BOTH[0] * BOTH[1]) as usize;
            let staging = HostBuffer::new(self.host, bytes as u64).expect("memory");
            let copied = self.host.run(|commands| {
                texture.record_read(self.host, commands, from, &staging);
                Ok(())
            });
            copied.expect("copied");
            let read = staging.read(self.host, bytes).expect("bytes");
            staging.destroy(self.host);
            bytemuck::pod_collect_to_vec(&read)
        };
        let [picks, motions] = &self.beside.textures;
        [texels(&self.textures[0], 4), texels(&self.textures[1], 1), texels(picks, 4), texels(motions, 1)]
    }

    fn destroy(self) {
        drop(self.images);
        self.textures.into_iter().for_each(|texture| texture.destroy(self.host));
        self.beside.destroy();
    }
}

/// A reservation for two players with every feature.
fn for_two(shared_sort: bool) -> Reservation {
    Reservation {
        views: 2,
        scenes: 3,
        shared_sort,
        images_only: true,
        occlusion: true,
        expected_depth: true,
        pick: true,
        motion: true,
        tint: true,
        cut_outs: 2,
        staging_bytes: Reservation::update_bytes(50, 1),
        ..Reservation::new(700, 1, SIZE[0], SIZE[1])
    }
}

#[test]
fn rectangles_have_the_bits_of_recordings_alone() {
    with_host(&options(), |host| {
        let context = guest(host);
        let (many, few) = (cloud(600, 7), cloud(50, 8));
        let scenes = [&many, &few].map(|g| DeviceScene::upload(&context, g, 0).expect("a scene"));
        let volume = Volume::Ellipsoid { radii: Vec3::splat(0.7) };
        let cut_outs = [CutOut { volume, pose: Pose::IDENTITY, inside: Inside::Removed }];
        let tinted = SceneSettings { tint: [1.0, 0.5, 0.5], cut_outs: &cut_outs, ..SceneSettings::default() };
        let pose = Pose {
            translation: Vec3::new(0.3, 0.2, -0.4),
            world_from_object: Mat3::from_rotation_y(0.7),
            scale: 1.3,
        };
        let before = Pose { translation: Vec3::ZERO, ..pose };
        let placed = [
            Placed { settings: tinted, ..Placed::from(&scenes[0]) },
            Placed { settings: SceneSettings { visible: false, ..tinted }, ..Placed::from(&scenes[0]) },
            Placed { previous_pose: Some(before), ..Placed::at(&scenes[1], pose) },
        ];
        let settings = RenderSettings::default();
        let left = camera(0.3, SIZE[0], SIZE[1]);
        let cameras = [left, left.moved_aside([0.3, 0.0])];
        let updates = [Update { scene: &scenes[1], first: 0, gaussians: &few }];
        let mut renderer = Renderer::new(&context).expect("kernels");
        let mut shots = Vec::new();
        for shared_sort in [false, true] {
            renderer.reserve(&for_two(shared_sort)).expect("memory");
            let split = Split::new(host, &renderer);
            let frame = |player: usize, used: Option<&Release>| {
                let updates: &[Update] = if player == 0 { &updates } else { &[] };
                let frame = RecordedFrame::new(&placed, &cameras[player], &settings);
                split.frame(RecordedFrame { updates, ..frame }, player as u32, used)
            };
            // Each player alone, the second one into the first one's images.
            let first = render_views(host, &mut renderer, &[frame(0, None)]);
            render_views(host, &mut renderer, &[frame(1, Some(&first[0]))]);
            shots.push(split.read());
            let after = Split::after_read(&first[0]);
            let again = [frame(0, Some(&after)), frame(1, None)];
            render_views(host, &mut renderer, &again);
            let report = renderer.slot_report(0).expect("a report").expect("finished");
            assert_eq!(report.sorts, if shared_sort { 1 } else { 2 });
            shots.push(split.read());
            split.destroy();
        }
        let expected = &shots[0];
        let drawn = |words: &Vec<u32>| words.iter().filter(|word| **word != 0).count();
        assert!(expected.iter().all(|words| drawn(words) > 500), "{:?}", expected.each_ref().map(drawn));
        for (number, shot) in shots.iter().enumerate() {
            for (what, (own, expected)) in shot.iter().zip(expected).enumerate() {
                let first = own.iter().zip(expected).position(|(a, b)| a != b);
                assert_eq!(first, None, "image {what} of shot {number}");
            }
        }
    });
}

#[test]
fn views_take_nothing_from_the_heap() {
    for push_descriptors in [true, false] {
        with_host(&HostOptions { push_descriptors, ..HostOptions::default() }, |host| {
            let context = shipped(host, true);
            let scene = DeviceScene::upload(&context, &cloud(300, 7), 0).expect("a scene");
            let (placed, settings) = ([Placed::from(&scene)], RenderSettings::default());
            let left = camera(0.3, SIZE[0], SIZE[1]);
            let cameras = [left, left.moved_aside([0.3, 0.0])];
            let mut renderer = Renderer::new(&context).expect("kernels");
            renderer.reserve(&Reservation { slots: 2, ..for_two(true) }).expect("memory");
            let split = Split::new(host, &renderer);
            let (mut used, mut asked) = ([Release::default(); 2], Vec::new());
            let in_flight = InFlight::new(host).expect("a command buffer");
            for number in 0..8 {
                let last = used[0];
                let views = [0, 1].map(|player| {
                    let frame = RecordedFrame::new(&placed, &cameras[player], &settings);
                    split.frame(frame, player as u32, (number > 0).then_some(&last))
                });
                in_flight.begin(host).expect("recording");
                let commands = adopt(&context, &in_flight);
                let (count, done) =
                    allocations(|| renderer.record_views(commands, number % 2, &views, &mut used));
                done.expect("a recording");
                in_flight.submit(host).expect("a submission");
                in_flight.wait(host).expect("done");
                asked.push(count);
            }
            assert!(asked[0] > 0, "the allocator counts");
            assert_eq!(asked[2..], [0; 6], "{asked:?}");
            in_flight.destroy(host);
            drop(renderer);
            split.destroy();
        });
    }
}
