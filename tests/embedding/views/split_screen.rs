//! Two players side by side, with every output of a frame.

use super::SIZE;
use crate::auxiliary::truth::Screens;
use crate::cost::shipped;
use crate::counting::allocations;
use crate::stage::*;

const BOTH: [u32; 2] = [2 * SIZE[0], SIZE[1]];

/// Images of a split screen for both players: colours, depths, occluder, picks and motion.
struct Split<'a> {
    pictures: [Picture<'a>; 3],
    beside: Screens<'a>,
}

impl<'a> Split<'a> {
    fn new(host: &'a Host, context: &Context) -> Self {
        let new = |purpose, format| Picture::new(host, context, ("split", purpose), format, BOTH);
        let pictures = [
            new(ImageUse::Target, vk::Format::R32G32B32A32_SFLOAT),
            new(ImageUse::Depth, vk::Format::R32_SFLOAT),
            new(ImageUse::Occluder, vk::Format::R32_SFLOAT),
        ];
        // The host's depth: z from 3 to 5 along the rows.
        let depth = |i: u32| 1.0 / (3.0 + 2.0 * (i % 59) as f32 / 59.0);
        pictures[2].texture.write(&(0..BOTH[0] * BOTH[1]).map(depth).collect::<Vec<f32>>());
        Self { pictures, beside: Screens::new(host, context, BOTH) }
    }

    fn frame<'b>(&'b self, frame: RecordedFrame<'b>, player: u32, last: &Release) -> RecordedFrame<'b> {
        let to = |picture: &'b Picture<'_>, from: Option<ImageState>| HostImage {
            offset: [player * SIZE[0], 0],
            ..host_image(&picture.image, from.unwrap_or(ImageState::UNDEFINED))
        };
        let [color, depth, occluder] = &self.pictures;
        let [picks, motions] = &self.beside.pictures;
        let mapping = DepthMapping { scale: 1.0, offset: 0.0, clear_value: 0.0, linear: false };
        RecordedFrame {
            target: Target::Image {
                to: to(color, last.color),
                behind: Background::Color([0.2, 0.3, 0.4]),
                encoding: ColorEncoding::AsTrained,
            },
            occluder: Some(Occluder { depth: to(occluder, last.occluder), mapping }),
            depth: Some(DepthTarget { to: to(depth, last.depth), min_weight: 0.5, empty: 0.0 }),
            pick: Some(to(picks, last.pick)),
            motion: Some(MotionTarget {
                to: to(motions, last.motion),
                previous_camera: frame.camera,
                min_weight: 0.1,
                empty: Some([0.0; 2]),
            }),
            ..frame
        }
    }

    /// States of images that no frame has used.
    fn unused() -> Release {
        let mut unused = Release::default();
        unused.occluder = Some(COPIED);
        unused
    }

    fn after_read(release: &Release) -> Release {
        let mut after = *release;
        for state in [&mut after.color, &mut after.depth, &mut after.pick, &mut after.motion] {
            *state = Some(READ);
        }
        after
    }

    fn read(&self) -> [Vec<u32>; 4] {
        let [color, depth, _] = &self.pictures;
        let [picks, motions] = &self.beside.pictures;
        [color, depth, picks, motions].map(|picture| picture.texture.read(WRITTEN))
    }
}

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
    with_guest(|host, context| {
        let (many, few) = (cloud(600, 7), cloud(50, 8));
        let scenes = [&many, &few].map(|g| uploaded(&context, g));
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
        let left = camera(0.3, SIZE[0], SIZE[1]);
        let cameras = [left, left.moved_aside([0.3, 0.0])];
        let updates = [Update { scene: &scenes[1], first: 0, gaussians: &few }];
        let mut renderer = Renderer::new(&context).expect("kernels");
        let mut shots = Vec::new();
        for shared_sort in [false, true] {
            renderer.reserve(&for_two(shared_sort)).expect("memory");
            let split = Split::new(host, &context);
            let frame = |player: usize, last: &Release| {
                let updates: &[Update] = if player == 0 { &updates } else { &[] };
                let frame = frame_of(&placed, &cameras[player]);
                split.frame(RecordedFrame { updates, ..frame }, player as u32, last)
            };
            // Each player alone, the second one into the first one's images.
            let first = render_views(host, &mut renderer, &[frame(0, &Split::unused())]);
            render_views(host, &mut renderer, &[frame(1, &first[0])]);
            shots.push(split.read());
            let after = Split::after_read(&first[0]);
            let again = [frame(0, &after), frame(1, &Split::unused())];
            render_views(host, &mut renderer, &again);
            let report = report_of(&mut renderer, 0);
            assert_eq!(report.sorts, if shared_sort { 1 } else { 2 });
            shots.push(split.read());
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
    // A device without push descriptors has descriptor sets to allocate.
    with_host(&HostOptions { push_descriptors: false, ..HostOptions::default() }, |host| {
        let context = shipped(host, true);
        let scene = uploaded(&context, &cloud(300, 7));
        let placed = [Placed::from(&scene)];
        let left = camera(0.3, SIZE[0], SIZE[1]);
        let cameras = [left, left.moved_aside([0.3, 0.0])];
        let split = Split::new(host, &context);
        let mut renderer = reserved(&context, &Reservation { slots: 2, ..for_two(true) });
        let (mut last, mut asked) = ([Split::unused(); 2], Vec::new());
        let commands = Commands::new(host);
        for number in 0..8 {
            let before = last[0];
            let frame = |player: usize| frame_of(&placed, &cameras[player]);
            let views = [0, 1].map(|player| split.frame(frame(player), player as u32, &before));
            let adopted = commands.begun(&context);
            let (count, done) = allocations(|| renderer.record_views(adopted, number % 2, &views, &mut last));
            done.expect("a recording");
            commands.finish();
            asked.push(count);
        }
        assert!(asked[0] > 0, "the allocator counts");
        assert_eq!(asked[2..], [0; 6], "{asked:?}");
    });
}
