//! Several views in one recording: layers of an array, rectangles of one image, with a sort of their own and with one for all.

use crate::array_image::ArrayImage;
use crate::auxiliary::truth::{Screens, WRITTEN};
use crate::cost::{allocations, shipped};
use crate::host::{Host, HostOptions, InFlight};
use crate::memory::{HostBuffer, HostTexture};
use crate::stage::{adopt, camera, cloud, guest, options, owned, with_host};
use ashsplat::ash::vk;
use ashsplat::scene::{CutOut, Gaussians, Inside, Pose, Volume};
use ashsplat::vk::{Image, ImageState, ImageUse};
use ashsplat::{
    Background, Camera, ColorEncoding, DepthTarget, DeviceScene, HostImage, MotionTarget, Occluder,
    PickTarget, Placed, RecordedFrame, Release, RenderSettings, Renderer, Reservation, SceneSettings, Target,
    Update,
};
use glam::{Mat3, Vec3};

const SIZE: [u32; 2] = [72, 56];
const BLACK: Background = Background::Color([0.0; 3]);

/// Colours of a view, as they were trained.
fn into(image: &Image, behind: Background, offset: [u32; 2]) -> Target<'_> {
    let to = HostImage { image, from: ImageState::UNDEFINED, offset };
    Target::Image { to, behind, encoding: ColorEncoding::AsTrained }
}

/// A cloud, with Gaussians that only one eye shows, and with some that none can.
fn hard_cloud() -> Gaussians {
    let mut hard = cloud(900, 4);
    for (i, x) in [f32::NAN, f32::INFINITY, 1e30, -1e38, 3.0e8].into_iter().enumerate() {
        hard.means[i][0] = x;
    }
    for (i, log_scale) in [60.0, 88.0, f32::NAN, 44.0].into_iter().enumerate() {
        hard.log_scales[10 + i] = [log_scale, -3.0, log_scale];
    }
    hard
}

/// Records, submits and waits.
fn render_views(host: &Host, renderer: &mut Renderer, views: &[RecordedFrame<'_>]) -> Vec<Release> {
    let in_flight = InFlight::new(host).expect("a command buffer");
    in_flight.begin(host).expect("recording");
    let mut releases = vec![Release::default(); views.len()];
    let commands = adopt(renderer.context(), &in_flight);
    renderer.record_views(commands, 0, views, &mut releases).expect("a recording");
    in_flight.submit(host).expect("a submission");
    in_flight.wait(host).expect("done");
    in_flight.destroy(host);
    releases
}

/// Two eyes, one beside them whose depths differ in the last bit, and a picture in a picture from elsewhere.
#[test]
fn layers_have_the_bits_of_frames_alone() {
    with_host(&options(), |host| {
        let context = guest(host);
        let gaussians = hard_cloud();
        let scene = DeviceScene::upload(&context, &gaussians, 0).expect("a scene");
        let left = camera(0.3, SIZE[0], SIZE[1]);
        let right = left.moved_aside([0.4, 0.1]);
        let mut nearly = right.moved_aside([0.4, 0.0]);
        nearly.translation.z = f32::from_bits(nearly.translation.z.to_bits() + 1);
        // A wider eye that is turned about the axis of view, of another size.
        let roll = Mat3::from_cols(Vec3::NEG_Y, Vec3::X, Vec3::Z);
        let turned = Camera {
            camera_from_world: roll * left.camera_from_world,
            translation: roll * left.translation,
            fx: 50.0,
            width: 40,
            height: 50,
            ..left
        };
        let elsewhere = camera(2.0, 33, 20);
        let cameras = [left, right, turned, nearly, elsewhere];
        let array = ArrayImage::new(host, SIZE, 5);
        let layers: Vec<Image> = (0..5).map(|layer| array.adopt(&context, layer)).collect();
        let (settings, placed) = (RenderSettings::default(), [Placed::from(&scene)]);
        let frames: Vec<RecordedFrame> = cameras
            .iter()
            .zip(&layers)
            .map(|(camera, layer)| RecordedFrame {
                target: into(layer, BLACK, [0; 2]),
                ..RecordedFrame::new(&placed, camera, &settings)
            })
            .collect();
        let expected = cameras.map(|camera| owned(&gaussians, &camera, &settings));
        let mut renderer = Renderer::new(&context).expect("kernels");
        for (shared_sort, sorts) in [(false, 5), (true, 3)] {
            let wanted =
                Reservation { views: 5, images_only: true, shared_sort, ..Reservation::new(900, 1, 72, 56) };
            renderer.reserve(&wanted).expect("memory");
            let releases = render_views(host, &mut renderer, &frames);
            assert!(releases.iter().all(|release| release.color == Some(written())), "{releases:?}");
            for ((layer, camera), frame) in array.read(host).iter().zip(&cameras).zip(&expected) {
                let (width, height) = (camera.width as usize, camera.height as usize);
                let rows = layer.chunks(SIZE[0] as usize).take(height).flat_map(|row| &row[..width]);
                let colors: Vec<[f32; 3]> = rows.map(|&[r, g, b, _]| [r, g, b]).collect();
                assert!(colors == frame.color, "shared: {shared_sort}, {width} x {height}");
            }
            let report = renderer.slot_report(0).expect("a report").expect("finished");
            let most = |of: fn(&ashsplat::FrameStats) -> u32| expected.iter().map(|f| of(&f.stats)).max();
            assert_eq!(report.sorts, sorts);
            assert_eq!(Some(report.instances_needed), most(|stats| stats.instances));
            assert_eq!(Some(report.longest_tile), most(|stats| stats.longest_tile));
            let visible = most(|stats| stats.visible).unwrap_or(0);
            // The eyes' together, or the most of one.
            assert!(if shared_sort { report.visible >= visible } else { report.visible == visible });
        }
        drop((renderer, layers));
        array.destroy(host);
    });
}

/// The use of an image that kernels have written.
fn written() -> ImageState {
    let read = vk::AccessFlags2::SHADER_STORAGE_READ;
    ImageState { accesses: WRITTEN.accesses | read, ..WRITTEN }
}

/// The images of a split screen: colours, depths, what hides, picks and motion, for both players side by side.
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
            // SAFETY: the images are as they say, and outlive the views.
            unsafe { Image::adopt(context, "split", &texture.foreign(), purpose) }.expect("adopted")
        };
        let images = [
            view(&textures[0], ImageUse::Storage),
            view(&textures[1], ImageUse::Storage),
            view(&textures[2], ImageUse::Sampled),
        ];
        let split = Self { host, textures, images, beside: Screens::new(host, context, BOTH) };
        split.write_depth();
        split
    }

    /// Slopes of the host's: z from 3 to 5, along the rows.
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

    /// A frame into the part of a player, with everything. `used`: by a recording before.
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
        let mapping =
            ashsplat::scene::DepthMapping { scale: 1.0, offset: 0.0, clear_value: 0.0, linear: false };
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

    /// How the images are used once they were read.
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

    /// Everything that was written.
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

/// A reservation for two players with everything.
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
            // Alone, the second one into what the first has left.
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

/// A picture in a picture, over it: views are drawn in their order.
#[test]
fn views_may_overlap() {
    with_host(&options(), |host| {
        let context = guest(host);
        let (gaussians, settings) = (cloud(300, 3), RenderSettings::default());
        let scene = DeviceScene::upload(&context, &gaussians, 0).expect("a scene");
        let placed = [Placed::from(&scene)];
        let array = ArrayImage::new(host, SIZE, 1);
        let image = array.adopt(&context, 0);
        let cameras = [camera(0.3, SIZE[0], SIZE[1]), camera(1.3, 30, 20)];
        let mut renderer = Renderer::new(&context).expect("kernels");
        renderer
            .reserve(&Reservation { views: 2, ..Reservation::new(300, 1, SIZE[0], SIZE[1]) })
            .expect("memory");
        let offsets = [[0; 2], [40, 30]];
        let views = [0, 1].map(|view| RecordedFrame {
            target: into(&image, [BLACK, Background::Image][view], offsets[view]),
            ..RecordedFrame::new(&placed, &cameras[view], &settings)
        });
        render_views(host, &mut renderer, &views);
        let [below, above] = [0, 1].map(|view| owned(&gaussians, &cameras[view], &settings));
        let texels = &array.read(host)[0];
        for (i, texel) in texels.iter().enumerate() {
            let [x, y] = [i % SIZE[0] as usize, i / SIZE[0] as usize];
            let behind = below.color[i];
            let inner = (x >= 40 && x < 70 && y >= 30 && y < 50).then(|| (y - 30) * 30 + x - 40);
            for channel in 0..3 {
                let expected = inner.map_or(behind[channel], |at| {
                    above.color[at][channel] + above.transmittance[at] * behind[channel]
                });
                assert!((texel[channel] - expected).abs() < 1e-6, "({x}, {y}): {texel:?}, not {expected}");
            }
        }
        drop((renderer, image));
        array.destroy(host);
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

#[test]
fn bad_views_are_refused_by_name() {
    with_host(&options(), |host| {
        let context = guest(host);
        let few = cloud(20, 7);
        let scene = DeviceScene::upload(&context, &few, 0).expect("a scene");
        let (placed, settings) = ([Placed::from(&scene)], RenderSettings::default());
        let (view, large) = (camera(0.3, SIZE[0], SIZE[1]), camera(0.3, 200, 200));
        let broken = Camera { fx: f32::NAN, ..view };
        let mut renderer = Renderer::new(&context).expect("kernels");
        let wanted = Reservation {
            views: 2,
            expected_depth: true,
            occlusion: true,
            ..Reservation::new(20, 1, 72, 56)
        };
        renderer.reserve(&wanted).expect("memory");
        let array = ArrayImage::new(host, [200, 200], 2);
        let layers = [0, 1].map(|layer| array.adopt(&context, layer));
        let (storage, sampled) = (vk::ImageUsageFlags::STORAGE, vk::ImageUsageFlags::SAMPLED);
        let both = HostTexture::new(host, vk::Format::R32_SFLOAT, storage | sampled, SIZE).expect("an image");
        let [read, write] = [ImageUse::Sampled, ImageUse::Storage].map(|purpose| {
            // SAFETY: the image is as it says, and outlives the view.
            unsafe { Image::adopt(&context, "both", &both.foreign(), purpose) }.expect("adopted")
        });
        let good = RecordedFrame {
            target: into(&layers[0], BLACK, [0; 2]),
            ..RecordedFrame::new(&placed, &view, &settings)
        };
        let slot = RecordedFrame { target: Target::Slot, ..good };
        let updates = [Update { scene: &scene, first: 0, gaussians: &few }];
        let updated = RecordedFrame { updates: &updates, ..good };
        let outside = RecordedFrame { target: into(&layers[1], BLACK, [150, 0]), ..good };
        let over = RecordedFrame { target: into(&layers[1], Background::Image, [0; 2]), ..good };
        let used = ImageState { layout: vk::ImageLayout::GENERAL, ..ImageState::UNDEFINED };
        let host_image = |image| HostImage { image, from: used, offset: [0; 2] };
        let writes = DepthTarget { to: host_image(&write), min_weight: 0.5, empty: 0.0 };
        let mapping =
            ashsplat::scene::DepthMapping { scale: 1.0, offset: 0.0, clear_value: 0.0, linear: false };
        let hides = RecordedFrame { occluder: Some(Occluder { depth: host_image(&read), mapping }), ..good };
        let cases: [(&[RecordedFrame], usize, &str); 11] = [
            (&[], 0, "views: there are none"),
            (&[good; 3], 3, "views: 3 of them, 2 are reserved"),
            (&[good; 2], 1, "releases: room for 1, there are 2 views"),
            (&[good, slot], 2, "views[1].target: is the slot's own buffer"),
            (&[slot, good], 2, "views[0].target: is the slot's own buffer"),
            (&[good, updated], 2, "views[1].updates: belong into views[0]"),
            (&[good, outside], 2, "views[1].target (image 'eye'): 72 x 56 pixels at (150, 0)"),
            (&[good, over], 2, "views[1].target (image 'eye'): the frame needs its contents"),
            (&[good, RecordedFrame { camera: &broken, ..good }], 2, "views[1].camera: "),
            (&[good, RecordedFrame { camera: &large, ..good }], 2, "views[1].camera: a picture of 200 x 200"),
            (
                &[RecordedFrame { depth: Some(writes), ..good }, hides],
                2,
                "views[1].occluder (image 'both'): is also views[0].depth: one samples it",
            ),
        ];
        let in_flight = InFlight::new(host).expect("a command buffer");
        in_flight.begin(host).expect("recording");
        for (views, room, expected) in cases {
            let mut releases = vec![Release::default(); room];
            let commands = adopt(&context, &in_flight);
            let error = renderer.record_views(commands, 0, views, &mut releases).expect_err(expected);
            assert!(error.to_string().contains(expected), "{error}");
            assert!(releases.iter().all(|release| *release == Release::default()));
        }
        let error = renderer.grow(&Reservation { views: 3, ..wanted }).expect_err("more views");
        assert!(error.to_string().contains("views is 3, 2 are reserved"), "{error}");
        // Of an error of a frame alone, there is no view to name.
        let alone = RecordedFrame { camera: &broken, ..good };
        let error = renderer.record(adopt(&context, &in_flight), 0, &alone).expect_err("no camera");
        assert!(!error.to_string().contains("views"), "{error}");
        in_flight.destroy(host);
        drop((renderer, layers, read, write));
        both.destroy(host);
        array.destroy(host);
    });
}

/// Processor time of this process so far, ms, in ticks of ten.
fn cpu_ms() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let ticks = stat.rsplit(')').next().unwrap_or_default().split_whitespace().skip(11).take(2);
    ticks.filter_map(|word| word.parse::<f64>().ok()).sum::<f64>() * 10.0
}

/// Two eyes in two recordings, in one, and in one with a shared sort: in turn.
#[test]
#[ignore = "prints a table of the guide"]
fn costs() {
    const GAUSSIANS: usize = 200_000;
    with_host(&HostOptions::default(), |host| {
        let context = shipped(host, true);
        let scene = DeviceScene::upload(&context, &cloud(GAUSSIANS, 1), 0).expect("a scene");
        let (placed, settings) = ([Placed::from(&scene)], RenderSettings::default());
        let left = camera(0.7, 640, 480);
        let cameras = [left, left.moved_aside([0.064, 0.0])];
        let array = ArrayImage::new(host, [640, 480], 2);
        let layers = [0, 1].map(|layer| array.adopt(&context, layer));
        let views = [0, 1].map(|view| RecordedFrame {
            target: into(&layers[view], BLACK, [0; 2]),
            ..RecordedFrame::new(&placed, &cameras[view], &settings)
        });
        let wanted = Reservation {
            slots: 2,
            views: 2,
            images_only: true,
            ..Reservation::new(GAUSSIANS as u32, 1, 640, 480)
        };
        let mut renderers = [false, true].map(|shared_sort| {
            let mut renderer = Renderer::new(&context).expect("kernels");
            let reserved = Reservation { shared_sort, ..wanted };
            let bytes = renderer.reservation_bytes(&reserved).expect("bytes");
            println!("shared sort: {shared_sort}: {:.1} MiB", bytes as f64 / 1024.0 / 1024.0);
            renderer.reserve(&reserved).expect("memory");
            renderer
        });
        let in_flight = InFlight::new(host).expect("a command buffer");
        let mut times = [const { [const { Vec::new() }; 4] }; 3];
        for round in 0..14 {
            for (case, times) in times.iter_mut().enumerate() {
                let renderer = &mut renderers[usize::from(case == 2)];
                let (cpu, start) = (cpu_ms(), std::time::Instant::now());
                in_flight.begin(host).expect("recording");
                let recording = std::time::Instant::now();
                let groups: &[&[RecordedFrame]] =
                    if case == 0 { &[&views[..1], &views[1..]] } else { &[&views] };
                for (slot, group) in (0..).zip(groups) {
                    let mut releases = [Release::default(); 2];
                    let releases = &mut releases[..group.len()];
                    let commands = adopt(&context, &in_flight);
                    renderer.record_views(commands, slot, group, releases).expect("a recording");
                }
                let recorded = recording.elapsed().as_secs_f64() * 1e6;
                in_flight.submit(host).expect("a submission");
                in_flight.wait(host).expect("done");
                let wall = start.elapsed().as_secs_f64() * 1e3;
                let device: f64 = (0..groups.len() as u32)
                    .flat_map(|slot| renderer.slot_report(slot).expect("a report").expect("finished").scopes)
                    .filter(|scope| scope.depth == 0)
                    .map(|scope| scope.nanoseconds / 1e6)
                    .sum();
                if round > 1 {
                    let all = [device, cpu_ms() - cpu, wall, recorded];
                    times.iter_mut().zip(all).for_each(|(times, ms)| times.push(ms));
                }
            }
        }
        println!(
            "recorded as | device, ms | CPU, ms | wall, ms | record, us | ratios of pairs to two recordings"
        );
        let first = times[0].clone();
        for (name, times) in ["two recordings", "one", "one, shared sort"].iter().zip(&times) {
            let median = |mut values: Vec<f64>| {
                values.sort_by(f64::total_cmp);
                values[values.len() / 2]
            };
            let ratio = |which: usize| {
                let pairs = times[which].iter().zip(&first[which]);
                median(pairs.map(|(own, other)| own / other).collect())
            };
            let [device, cpu, wall, record] = times.clone().map(median);
            let ratios = [0, 1, 2, 3].map(ratio);
            println!("{name} | {device:.1} | {cpu:.0} | {wall:.1} | {record:.0} | {ratios:.2?}");
        }
        in_flight.destroy(host);
        drop((renderers, layers));
        array.destroy(host);
    });
}
