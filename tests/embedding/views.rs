//! Several views in one recording: layers of an array or rectangles of one image, each with its own sort or with a
//! shared one.

mod at_random;
mod split_screen;

use crate::array_image::ArrayImage;
use crate::stage::*;

const SIZE: [u32; 2] = [72, 56];
pub const BLACK: Background = Background::Color([0.0; 3]);

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

/// Two eyes, one beside them whose depths differ in the last bit, and a picture-in-picture from elsewhere.
#[test]
fn layers_have_the_bits_of_frames_alone() {
    with_guest(|host, context| {
        let gaussians = hard_cloud();
        let scene = uploaded(&context, &gaussians);
        // Each eye sees Gaussians that the other does not.
        let left = camera(0.3, SIZE[0], SIZE[1]).moved_aside([-1.0, 0.0]);
        let right = left.moved_aside([2.0, 0.1]);
        let mut nearly = right.moved_aside([0.4, 0.0]);
        nearly.translation.z = f32::from_bits(nearly.translation.z.to_bits() + 1);
        // A wider eye, rolled about the view axis, of another size.
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
        let array = ArrayImage::new(host, &context, SIZE, 5);
        let placed = [Placed::from(&scene)];
        let frames = array.frames(&placed, &cameras);
        let expected = cameras.map(|camera| owned(&gaussians, &camera, &SETTINGS));
        let mut renderer = Renderer::new(&context).expect("kernels");
        for (shared_sort, sorts) in [(false, 5), (true, 3)] {
            let wanted =
                Reservation { views: 5, images_only: true, shared_sort, ..Reservation::new(900, 1, 72, 56) };
            renderer.reserve(&wanted).expect("memory");
            let releases = render_views(host, &mut renderer, &frames);
            assert!(releases.iter().all(|release| release.color == Some(written())), "{releases:?}");
            for ((layer, camera), frame) in array.read().iter().zip(&cameras).zip(&expected) {
                let (width, height) = (camera.width as usize, camera.height as usize);
                let rows = layer.chunks(SIZE[0] as usize).take(height).flat_map(|row| &row[..width]);
                let colors: Vec<[f32; 3]> = rows.map(|&[r, g, b, _]| [r, g, b]).collect();
                assert!(colors == frame.color, "shared: {shared_sort}, {width} x {height}");
            }
            let report = report_of(&mut renderer, 0);
            let max = |of: fn(&ashsplat::FrameStats) -> u32| expected.iter().map(|f| of(&f.stats)).max();
            assert_eq!(report.sorts, sorts);
            assert_eq!(Some(report.instances_needed), max(|stats| stats.instances));
            assert_eq!(Some(report.longest_tile), max(|stats| stats.longest_tile));
            let visible = max(|stats| stats.visible).unwrap_or(0);
            // A shared sort counts Gaussians that any eye sees. Without it, the largest count of an eye is reported.
            assert!(if shared_sort { report.visible >= visible } else { report.visible == visible });
        }
    });
}

/// Eyes side by side have other distances of a Gaussian, so each sorts alone.
#[test]
fn layers_in_the_order_of_distances_have_the_bits_of_frames_alone() {
    with_guest(|host, context| {
        let gaussians = hard_cloud();
        let scene = uploaded(&context, &gaussians);
        let left = camera(0.3, SIZE[0], SIZE[1]).moved_aside([-1.0, 0.0]);
        let cameras = [left, left.moved_aside([2.0, 0.1])];
        let array = ArrayImage::new(host, &context, SIZE, 2);
        let (placed, settings) =
            ([Placed::from(&scene)], RenderSettings { distance_order: true, ..*SETTINGS });
        let mut frames = array.frames(&placed, &cameras);
        frames.iter_mut().for_each(|frame| frame.settings = &settings);
        let eyes = Reservation { views: 2, images_only: true, ..Reservation::new(900, 1, 72, 56) };
        let mut renderer =
            reserved(&context, &Reservation { shared_sort: true, distance_order: true, ..eyes });
        render_views(host, &mut renderer, &frames);
        assert_eq!(report_of(&mut renderer, 0).sorts, 2);
        for (layer, camera) in array.read().iter().zip(&cameras) {
            let colors: Vec<[f32; 3]> = layer.iter().map(|&[r, g, b, _]| [r, g, b]).collect();
            assert!(colors == owned(&gaussians, camera, &settings).color);
            assert!(colors != owned(&gaussians, camera, &SETTINGS).color);
        }
    });
}

fn written() -> ImageState {
    let read = vk::AccessFlags2::SHADER_STORAGE_READ;
    ImageState { accesses: WRITTEN.accesses | read, ..WRITTEN }
}

#[test]
fn bad_views_are_refused_by_name() {
    with_guest(|host, context| {
        let few = cloud(20, 7);
        let scene = uploaded(&context, &few);
        let placed = [Placed::from(&scene)];
        let (view, large) = (camera(0.3, SIZE[0], SIZE[1]), camera(0.3, 200, 200));
        let broken = Camera { fx: f32::NAN, ..view };
        let wanted = Reservation { views: 2, occlusion: true, ..Reservation::new(20, 1, 72, 56) };
        let wanted = Reservation { expected_depth: true, ..wanted };
        let mut renderer = reserved(&context, &wanted);
        let array = ArrayImage::new(host, &context, [200, 200], 2);
        let (storage, sampled) = (vk::ImageUsageFlags::STORAGE, vk::ImageUsageFlags::SAMPLED);
        let both = Texture::new(host, vk::Format::R32_SFLOAT, storage | sampled, SIZE);
        let read = both.adopt(&context, "both", ImageUse::Occluder);
        let write = both.adopt(&context, "both", ImageUse::Depth);
        let good =
            RecordedFrame { target: into(&array.layers[0], BLACK, [0; 2]), ..frame_of(&placed, &view) };
        let slot = RecordedFrame { target: Target::Slot, ..good };
        let updates = [Update { scene: &scene, first: 0, gaussians: &few }];
        let updated = RecordedFrame { updates: &updates, ..good };
        let outside = RecordedFrame { target: into(&array.layers[1], BLACK, [150, 0]), ..good };
        let over = RecordedFrame { target: into(&array.layers[1], Background::Image, [0; 2]), ..good };
        let used = ImageState { layout: vk::ImageLayout::GENERAL, ..ImageState::UNDEFINED };
        let host_image = |image| HostImage { image, from: used, offset: [0; 2] };
        let writes = DepthTarget { to: host_image(&write), min_weight: 0.5, empty: 0.0 };
        let mapping = DepthMapping { scale: 1.0, offset: 0.0, clear_value: 0.0, linear: false };
        let hides = RecordedFrame { occluder: Some(Occluder { depth: host_image(&read), mapping }), ..good };
        let deep = RenderSettings { inverse_depth: true, ..*SETTINGS };
        let faint = SceneSettings { opacity: 0.5, ..SceneSettings::default() };
        let tinted = [Placed { settings: faint, ..Placed::from(&scene) }];
        let cases: [(&[RecordedFrame], usize, &str); 13] = [
            (&[], 0, "views: there are none"),
            (&[good; 3], 3, "views: 3 of them, Reservation::views is 2"),
            (
                &[good, RecordedFrame { settings: &deep, ..good }],
                2,
                "Reservation::inverse_depth: not reserved, and the frame needs it, in views[1]",
            ),
            (
                &[good, RecordedFrame { scenes: &tinted, ..good }],
                2,
                "Reservation::tint: not reserved, and scenes[0] has a tint or an opacity, in views[1]",
            ),
            (&[good; 2], 1, "releases: 1 of them, there are 2 views"),
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
                "views[1].occluder (image 'both'): is also views[0].depth: the views take it for different purposes",
            ),
        ];
        let in_flight = Commands::new(host);
        in_flight.begin();
        for (views, room, expected) in cases {
            let mut releases = vec![Release::default(); room];
            let commands = in_flight.adopt(&context);
            let error = renderer.record_views(commands, 0, views, &mut releases).expect_err(expected);
            assert!(error.to_string().contains(expected), "{error}");
            assert!(releases.iter().all(|release| *release == Release::default()));
        }
        let error = renderer.grow(&Reservation { views: 3, ..wanted }).expect_err("more views");
        assert!(error.to_string().contains("views is 3, 2 are reserved"), "{error}");
        // The error of a single frame names no view.
        let alone = RecordedFrame { camera: &broken, ..good };
        let error = renderer.record(in_flight.adopt(&context), 0, &alone).expect_err("no camera");
        assert!(!error.to_string().contains("views"), "{error}");
    });
}
