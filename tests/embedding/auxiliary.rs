//! Picks and motion of a frame, compared with the host's own arithmetic.

pub mod flight;
pub mod truth;

use crate::orthographic;
use crate::scene_settings::{HIDDEN, USUAL};
use crate::stage::*;
use ashsplat::kernels::constants::NOT_PICKED;
use truth::{SIZE, Screens, Truth, ball, both, round, shifted, turned};

#[test]
fn picks_and_motion_of_random_scenes() {
    with_guest(|host, context| {
        let view = camera(0.3, SIZE[0], SIZE[1]);
        let before = turned(&shifted(&view, [0.05, -0.02, 0.1]), -0.03);
        let parts = [round(300, 1), round(257, 2), round(200, 3)];
        let scenes: Vec<_> = parts.iter().map(|part| uploaded(&context, part)).collect();
        let screens = Screens::new(host, &context, SIZE);
        let pose = |angle: f32, x: f32, scale| Pose {
            world_from_object: Mat3::from_quat(Quat::from_rotation_z(angle)),
            translation: Vec3::new(x, 0.1, -x),
            scale,
        };
        let (poses, earlier) = (
            [Pose::IDENTITY, pose(0.5, 0.3, 1.25), pose(-0.25, -0.2, 0.75)],
            [Pose::IDENTITY, pose(0.45, 0.35, 1.25), pose(-0.25, -0.2, 0.8)],
        );
        let mut colors = Vec::new();
        for form in Blending::ALL {
            let mut renderer = Renderer::new(&context).expect("kernels");
            renderer.set_blending(form);
            let wanted = Reservation::new(757, 0, SIZE[0], SIZE[1]);
            let wanted = Reservation { scenes: 3, cut_outs: 1, occlusion: true, ..wanted };
            renderer.reserve(&both(wanted)).expect("memory");
            let placed = |own: [SceneSettings<'static>; 3]| -> Vec<Placed<'_>> {
                let placed = |i: usize| Placed {
                    settings: own[i],
                    previous_pose: Some(earlier[i]),
                    ..Placed::at(&scenes[i], poses[i])
                };
                vec![placed(0), placed(1), placed(2)]
            };
            let of = |i: usize| (i as u32, &parts[i], poses[i], earlier[i]);
            let all = placed([USUAL; 3]);
            let frame = frame_of(&all, &view);
            let shot = screens.shot(&mut renderer, &frame, &before);
            let truth = Truth::new(&[of(0), of(1), of(2)], [&view, &before]);
            let covered = truth.check(&shot, SIZE);
            assert!(covered > 2000, "{covered}");
            // Picks and motion leave the picture's bits, and each alone equals both.
            let plain = rendered(host, &mut renderer, &frame);
            assert!(plain == shot.pixels, "{form:?}: the picture changes");
            let pick = RecordedFrame { pick: Some(screens.pick()), ..frame };
            assert!(rendered(host, &mut renderer, &pick) == plain);
            assert!(screens.picks() == shot.picks);
            let motion = RecordedFrame { motion: Some(screens.motion(&before)), ..frame };
            assert!(rendered(host, &mut renderer, &motion) == plain);
            assert!(screens.motions() == shot.motions);
            // Scene indices do not change if another scene is hidden.
            for (hidden, others) in [(0, [1, 2]), (1, [0, 2]), (2, [0, 1])] {
                let mut own = [USUAL; 3];
                own[hidden] = HIDDEN;
                let placed = placed(own);
                let frame = RecordedFrame { scenes: &placed, ..frame };
                let shot = screens.shot(&mut renderer, &frame, &before);
                Truth::new(&others.map(of), [&view, &before]).check(&shot, SIZE);
            }
            // Behind the host's wall.
            let wall = 4.1;
            let picture = Picture::of_depth(host, &context, SIZE, 0.1 / wall);
            let depth = host_image(&picture.image, COPIED);
            let mapping = DepthMapping { scale: 10.0, offset: 0.0, clear_value: 0.0, linear: false };
            let hidden = RecordedFrame { occluder: Some(Occluder { depth, mapping }), ..frame };
            let shot = screens.shot(&mut renderer, &hidden, &before);
            let mut truth = truth;
            truth.limit = f64::from(wall);
            let left = truth.check(&shot, SIZE);
            assert!(left > 500 && left < covered, "{left} of {covered}");
            rendered(host, &mut renderer, &frame);
            colors.push((shot.picks, shot.motions));
        }
        // Both forms blend identically.
        assert!(colors[0] == colors[1]);
    });
}

/// A scene with parameters in several buffers, and with splat attributes apart.
#[test]
fn picks_and_motion_go_on_from_chunk_to_chunk() {
    with_host(&options(), |host| {
        let context = guest_of_small_bindings(host);
        let size = [80, 60];
        let view = camera(0.3, size[0], size[1]);
        let before = shifted(&view, [0.05, 0.0, 0.02]);
        let part = round(2500, 6);
        let scene = uploaded(&context, &part);
        assert!(scene.plan().chunks > 1);
        let mut renderer = reserved(&context, &both(Reservation::new(2500, 0, size[0], size[1])));
        let screens = Screens::new(host, &context, size);
        let placed = [Placed::from(&scene)];
        let shot = screens.shot(&mut renderer, &frame_of(&placed, &view), &before);
        let truth = Truth::new(&[(0, &part, Pose::IDENTITY, Pose::IDENTITY)], [&view, &before]);
        assert!(truth.check(&shot, size) > 2000);
        assert!(shot.picks.iter().any(|pick| pick[0] > 2400 && pick[0] < 2500), "none of the last chunk");
    });
}

/// More scenes than one command writes first Gaussians for, a tenth of them hidden: one at each fourth pixel of a
/// grid.
#[test]
fn picks_know_a_thousand_scenes() {
    const COLUMNS: u32 = 44;
    const SCENES: u32 = 25 * COLUMNS;
    with_guest(|host, context| {
        let (width, height) = (4 * COLUMNS, 100);
        let view = Camera { cx: 0.5, cy: 0.5, ..camera(0.0, width, height) };
        let small = ball(&view, [0.0, 0.0, 4.0], [0.001, 0.9]);
        let scene = uploaded(&context, &small);
        let wanted = Reservation { scenes: SCENES, ..Reservation::new(SCENES, 0, width, height) };
        let mut renderer = reserved(&context, &Reservation { pick: true, ..wanted });
        let screens = Screens::new(host, &context, [width, height]);
        let place = |scene: u32| [4 * (scene % COLUMNS) + 2, 4 * (scene / COLUMNS) + 1];
        let is_hidden = |scene: u32| scene.is_multiple_of(10) || (1020..1030).contains(&scene);
        let placed: Vec<Placed> = (0..SCENES)
            .map(|index| {
                let [x, y] = place(index).map(|at| at as f32 / view.fx * 4.0);
                let translation = view.camera_from_world.transpose() * Vec3::new(x, y, 0.0);
                let settings = if is_hidden(index) { HIDDEN } else { USUAL };
                Placed { settings, ..Placed::at(&scene, Pose { translation, ..Pose::IDENTITY }) }
            })
            .collect();
        let settings = RenderSettings::default();
        let pick = Some(screens.pick());
        let frame = RecordedFrame { pick, ..RecordedFrame::new(&placed, &view, &settings) };
        rendered(host, &mut renderer, &frame);
        let picks = screens.picks();
        for index in 0..SCENES {
            let [x, y] = place(index);
            let [gaussian, found, ..] = picks[(y * width + x) as usize];
            let expected = if is_hidden(index) { [NOT_PICKED; 2] } else { [0, index] };
            assert_eq!([gaussian, found], expected, "scene {index}");
        }
    });
}

/// A part of a larger image, its previous contents, and pixels with little coverage.
#[test]
fn picks_and_motion_go_into_a_part_of_an_image() {
    with_guest(|host, context| {
        let view = camera(0.3, 48, 33);
        let before = shifted(&view, [0.1, 0.0, 0.0]);
        let part = round(60, 5);
        let scene = uploaded(&context, &part);
        let mut renderer = reserved(&context, &both(Reservation::new(60, 0, 48, 33)));
        let (whole, own) = (Screens::new(host, &context, SIZE), Screens::new(host, &context, [48, 33]));
        let placed = [Placed::from(&scene)];
        let frame = frame_of(&placed, &view);
        let shot = own.shot(&mut renderer, &frame, &before);
        // First the whole image, then a part over its contents.
        let large = camera(0.3, SIZE[0], SIZE[1]);
        let cleared = [Placed { settings: HIDDEN, ..placed[0] }];
        renderer.reserve(&both(Reservation::new(60, 0, SIZE[0], SIZE[1]))).expect("memory");
        let mut motion = whole.motion(&large);
        motion.empty = Some([3.0, -4.0]);
        let all =
            RecordedFrame { pick: Some(whole.pick()), motion: Some(motion), ..frame_of(&cleared, &large) };
        rendered(host, &mut renderer, &all);
        assert!(whole.motions().iter().all(|motion| *motion == [3.0, -4.0]));
        let offset = [29, 31];
        // The motion image was read last. The picks are still in the state of their write.
        let motion = MotionTarget {
            to: HostImage { from: READ, offset, ..whole.to(1) },
            min_weight: 0.5,
            empty: None,
            ..whole.motion(&before)
        };
        let pick = HostImage { from: WRITTEN, offset, ..whole.to(0) };
        let pixels =
            rendered(host, &mut renderer, &RecordedFrame { pick: Some(pick), motion: Some(motion), ..frame });
        assert!(pixels == shot.pixels);
        let (picks, motions) = (whole.picks(), whole.motions());
        let mut kinds = [0; 3];
        for (index, (pick, motion)) in picks.into_iter().zip(motions).enumerate() {
            let [x, y] = [index as u32 % SIZE[0], index as u32 / SIZE[0]];
            let inside = (offset[0]..offset[0] + 48).contains(&x) && (offset[1]..offset[1] + 33).contains(&y);
            let place = if inside { ((y - offset[1]) * 48 + x - offset[0]) as usize } else { 0 };
            let kind = match inside {
                false => 0,
                true if 1.0 - shot.pixels[place][3] < 0.5 => 1,
                true => 2,
            };
            kinds[kind] += 1;
            let nothing = [NOT_PICKED, NOT_PICKED, 0, 0];
            assert_eq!(pick, if inside { shot.picks[place] } else { nothing }, "({x}, {y})");
            assert_eq!(motion, if kind == 2 { shot.motions[place] } else { [3.0, -4.0] }, "({x}, {y})");
        }
        assert!(kinds.iter().all(|&count| count > 50), "{kinds:?}");
    });
}

/// Refusals name the caller's field. Outputs that are not reserved take no memory.
#[test]
fn bad_picks_and_motions_are_refused_by_name() {
    with_guest(|host, context| {
        let view = camera(0.3, SIZE[0], SIZE[1]);
        let scene = uploaded(&context, &round(60, 5));
        let mut renderer = Renderer::new(&context).expect("kernels");
        let plain = Reservation::new(60, 0, SIZE[0], SIZE[1]);
        let bytes = |wanted: &Reservation| renderer.reservation_bytes(wanted).expect("bytes");
        let pixels = u64::from(SIZE[0] * SIZE[1]);
        let more = bytes(&both(plain)) - bytes(&plain);
        // A buffer that is not reserved takes its padding.
        assert!((16 * pixels - 1024..16 * pixels + 4096).contains(&more), "{more}");
        let screens = Screens::new(host, &context, SIZE);
        let small = Screens::new(host, &context, [SIZE[0], SIZE[1] - 1]);
        let placed = [Placed::from(&scene)];
        let good = frame_of(&placed, &view);
        let pick = |to| RecordedFrame { pick: Some(to), ..good };
        let usual = screens.motion(&view);
        let motion = |motion| RecordedFrame { motion: Some(motion), ..good };
        let wider = Camera { width: SIZE[0] + 1, ..view };
        let nowhere = Camera { fx: f32::NAN, ..view };
        let flat = parallel(&view);
        let lost = Pose { translation: Vec3::NAN, ..Pose::IDENTITY };
        let lost = [Placed { previous_pose: Some(lost), ..placed[0] }];
        let assert_refused = |renderer: &mut Renderer, frame: &RecordedFrame<'_>, expected: &str| {
            assert_argument(&refused(host, renderer, frame), expected);
        };
        renderer.reserve(&plain).expect("memory");
        assert_refused(
            &mut renderer,
            &pick(screens.to(0)),
            "Reservation::pick: not reserved, and the frame needs it",
        );
        assert_refused(&mut renderer, &motion(usual), "Reservation::motion: not reserved");
        renderer.reserve(&both(plain)).expect("memory");
        let bad = [
            (pick(screens.to(1)), "pick (image 'beside'): it was adopted for Motion, not for Pick"),
            (pick(small.to(0)), "pick (image 'beside'): 96 x 70 pixels at (0, 0) exceed its 96 x 69"),
            (motion(MotionTarget { to: screens.to(0), ..usual }), "it was adopted for Pick, not for Motion"),
            (motion(MotionTarget { to: small.to(1), ..usual }), "motion (image 'beside'): 96 x 70 pixels"),
            (
                motion(MotionTarget { previous_camera: &wider, ..usual }),
                "motion.previous_camera: is of 97 x 70 pixels, the frame of 96 x 70",
            ),
            (motion(MotionTarget { previous_camera: &nowhere, ..usual }), "motion.previous_camera"),
            (
                motion(MotionTarget { previous_camera: &flat, ..usual }),
                "Reservation::orthographic: not reserved, and the frame needs it",
            ),
            (motion(MotionTarget { min_weight: f32::NAN, ..usual }), "motion.min_weight: NaN"),
            (motion(MotionTarget { empty: Some([0.0, f32::NAN]), ..usual }), "motion.empty: [0.0, NaN]"),
            (motion(MotionTarget { empty: Some([1e5, 0.0]), ..usual }), "each may be -65504 to 65504"),
            (motion(MotionTarget { empty: None, ..usual }), "UNDEFINED"),
            (RecordedFrame { scenes: &lost, ..good }, "scenes[0].previous_pose"),
        ];
        for (frame, expected) in bad {
            assert_refused(&mut renderer, &frame, expected);
        }
        // Nothing was recorded, and the renderer still works.
        let shot = screens.shot(&mut renderer, &good, &view);
        assert_same(&shot.pixels, &owned(&round(60, 5), &view, &SETTINGS));
    });
}

/// Orthographic camera with the pixels per unit of a pinhole at a distance of 4.
pub fn parallel(camera: &Camera) -> Camera {
    Camera { fx: camera.fx / 4.0, fy: camera.fy / 4.0, ..camera.orthographic() }
}

#[test]
fn picks_and_motion_of_orthographic_cameras() {
    with_guest(|host, context| {
        let view = camera(0.3, SIZE[0], SIZE[1]);
        let before = turned(&shifted(&view, [0.05, -0.02, 0.1]), -0.03);
        let parts = [round(300, 1), round(257, 2)];
        let scenes = parts.each_ref().map(|part| uploaded(&context, part));
        let pose = |angle, scale| Pose {
            world_from_object: Mat3::from_rotation_z(angle),
            translation: Vec3::new(0.3, 0.1, -0.3),
            scale,
        };
        let poses = [[Pose::IDENTITY; 2], [pose(0.5, 1.25), pose(0.45, 1.2)]];
        let place =
            |i: usize| Placed { previous_pose: Some(poses[i][1]), ..Placed::at(&scenes[i], poses[i][0]) };
        let placed = [place(0), place(1)];
        let of = |i: usize| (i as u32, &parts[i], poses[i][0], poses[i][1]);
        let screens = Screens::new(host, &context, SIZE);
        for form in Blending::ALL {
            let mut renderer = Renderer::new(&context).expect("kernels");
            renderer.set_blending(form);
            let wanted =
                Reservation { scenes: 2, orthographic: true, ..Reservation::new(557, 0, SIZE[0], SIZE[1]) };
            renderer.reserve(&both(wanted)).expect("memory");
            let pairs =
                [(parallel(&view), parallel(&before)), (parallel(&view), before), (view, parallel(&before))];
            for (now, before) in &pairs {
                let frame = frame_of(&placed, now);
                let shot = screens.shot(&mut renderer, &frame, before);
                let covered = Truth::new(&[of(0), of(1)], [now, before]).check(&shot, SIZE);
                assert!(covered > 1500, "{covered}");
            }
            let now = parallel(&view);
            let still = [0, 1].map(|i| Placed::at(&scenes[i], poses[i][0]));
            let shot = screens.shot(&mut renderer, &frame_of(&still, &now), &now);
            assert!(shot.motions.iter().all(|motion| *motion == [0.0; 2]), "what stands still moves");
        }
    });
}

/// The depth of a pick, through the host's mapping, equals that of the host's matrices.
#[test]
fn picks_have_the_depth_of_an_orthographic_host() {
    with_guest(|host, context| {
        let mut renderer = Renderer::new(&context).expect("kernels");
        let size = orthographic::SIZE;
        let wanted =
            Reservation { pick: true, orthographic: true, ..Reservation::new(2, 0, size[0], size[1]) };
        renderer.reserve(&wanted).expect("memory");
        let screens = Screens::new(host, &context, size);
        for reversed in [false, true] {
            let matrices = orthographic::view(reversed);
            let (view, mapping) = matrices.camera().expect("a camera");
            // In front of the eye, and behind it, where the near plane lies.
            for z in [1.0, 5.0] {
                let one = ball(&view, [0.2, -0.15, z], [0.1, 0.9]);
                let mean = Vec3::from(one.means[0]);
                let scene = uploaded(&context, &one);
                let placed = [Placed::from(&scene)];
                let pick = Some(screens.pick());
                let frame = RecordedFrame { pick, ..frame_of(&placed, &view) };
                rendered(host, &mut renderer, &frame);
                let (x, y, _) = view.project(mean);
                let [gaussian, scene, depth, _] = screens.picks()[(y as u32 * size[0] + x as u32) as usize];
                let clip = matrices.clip_from_view * matrices.view_from_world * mean.extend(1.0);
                let found = mapping.depth(f32::from_bits(depth));
                assert_eq!([gaussian, scene], [0, 0]);
                assert!((found - clip.z).abs() < 1e-5, "z {z}: {found}, {}", clip.z);
            }
        }
    });
}

/// The previous camera stood among the Gaussians. Those behind it have no motion. The motion of those near its plane
/// is at most the picture's size.
#[test]
fn gaussians_that_the_earlier_camera_did_not_see_do_not_outweigh_others() {
    with_guest(|host, context| {
        let view = camera(0.3, SIZE[0], SIZE[1]);
        let before = shifted(&view, [0.0, 0.0, 4.0]);
        let part = round(400, 7);
        let scene = uploaded(&context, &part);
        let mut renderer = reserved(&context, &both(Reservation::new(400, 0, SIZE[0], SIZE[1])));
        let screens = Screens::new(host, &context, SIZE);
        let placed = [Placed::from(&scene)];
        let shot = screens.shot(&mut renderer, &frame_of(&placed, &view), &before);
        let truth = Truth::new(&[(0, &part, Pose::IDENTITY, Pose::IDENTITY)], [&view, &before]);
        let count =
            |is: &dyn Fn([f64; 2]) -> bool| truth.who.iter().filter(|(.., motion)| is(*motion)).count();
        let [w, h] = SIZE.map(f64::from);
        let (unknown, cut) = (count(&|m| m == [0.0; 2]), count(&|[x, y]| x.abs() == w || y.abs() == h));
        assert!(unknown > 100 && cut > 20, "{unknown} behind, {cut} cut");
        assert!(truth.check(&shot, SIZE) > 1500);
        assert!(shot.picks.iter().any(|pick| pick[1] != NOT_PICKED));
        assert!(shot.motions.iter().all(|[x, y]| f64::from(x.abs()) <= w && f64::from(y.abs()) <= h));
    });
}
