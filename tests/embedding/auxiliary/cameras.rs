//! Picks and motion of orthographic cameras, and of cameras that do not see all that the other one sees.

use super::truth::{SIZE, Screens, Truth, ball, both, round, shifted, turned};
use crate::orthographic;
use crate::stage::{adopt, camera, guest, options, with_host};
use ashsplat::kernels::constants::NOT_PICKED;
use ashsplat::scene::{Camera, Pose};
use ashsplat::{Blending, DeviceScene, Placed, RecordedFrame, RenderSettings, Renderer, Reservation};
use glam::{Mat3, Vec3};

/// Orthographic camera with the pixels per unit of a pinhole at a distance of 4.
fn parallel(camera: &Camera) -> Camera {
    Camera { fx: camera.fx / 4.0, fy: camera.fy / 4.0, ..camera.orthographic() }
}

/// Orthographic cameras in this frame, in the previous one, and in both.
#[test]
fn picks_and_motion_of_orthographic_cameras() {
    with_host(&options(), |host| {
        let context = guest(host);
        let view = camera(0.3, SIZE[0], SIZE[1]);
        let before = turned(&shifted(&view, [0.05, -0.02, 0.1]), -0.03);
        let parts = [round(300, 1), round(257, 2)];
        let scenes = parts.each_ref().map(|part| DeviceScene::upload(&context, part, 0).expect("a scene"));
        let pose = |angle, scale| Pose {
            world_from_object: Mat3::from_rotation_z(angle),
            translation: Vec3::new(0.3, 0.1, -0.3),
            scale,
        };
        let poses = [[Pose::IDENTITY; 2], [pose(0.5, 1.25), pose(0.45, 1.2)]];
        let place =
            |i: usize| Placed { previous_pose: Some(poses[i][1]), ..Placed::at(&scenes[i], poses[i][0]) };
        let (placed, settings) = ([place(0), place(1)], RenderSettings::default());
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
                let frame = RecordedFrame::new(&placed, now, &settings);
                let shot = screens.shot(&mut renderer, &frame, before);
                let covered = Truth::new(&[of(0), of(1)], [now, before]).check(&shot, SIZE);
                assert!(covered > 1500, "{covered}");
            }
            let now = parallel(&view);
            let still = [0, 1].map(|i| Placed::at(&scenes[i], poses[i][0]));
            let shot = screens.shot(&mut renderer, &RecordedFrame::new(&still, &now, &settings), &now);
            assert!(shot.motions.iter().all(|motion| *motion == [0.0; 2]), "what stands still moves");
        }
        screens.destroy();
    });
}

/// The depth of a pick, through the host's mapping, equals that of the host's matrices.
#[test]
fn picks_have_the_depth_of_an_orthographic_host() {
    with_host(&options(), |host| {
        let context = guest(host);
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
                let scene = DeviceScene::upload(&context, &one, 0).expect("a scene");
                let (placed, settings) = ([Placed::from(&scene)], RenderSettings::default());
                let pick = Some(ashsplat::PickTarget { to: screens.to(0) });
                let frame = RecordedFrame { pick, ..RecordedFrame::new(&placed, &view, &settings) };
                crate::stage::rendered(host, &mut renderer, &frame);
                let (x, y, _) = view.project(mean);
                let [gaussian, scene, depth, _] =
                    screens.read::<[u32; 4]>(0)[(y as u32 * size[0] + x as u32) as usize];
                let clip = matrices.clip_from_view * matrices.view_from_world * mean.extend(1.0);
                let found = mapping.depth(f32::from_bits(depth));
                assert_eq!([gaussian, scene], [0, 0]);
                assert!((found - clip.z).abs() < 1e-5, "z {z}: {found}, {}", clip.z);
            }
        }
        drop(renderer);
        screens.destroy();
    });
}

/// An orthographic previous camera must be reserved like a current one.
#[test]
fn an_orthographic_camera_before_is_reserved() {
    with_host(&options(), |host| {
        let context = guest(host);
        let view = camera(0.3, SIZE[0], SIZE[1]);
        let scene = DeviceScene::upload(&context, &round(60, 5), 0).expect("a scene");
        let mut renderer = Renderer::new(&context).expect("kernels");
        renderer.reserve(&both(Reservation::new(60, 0, SIZE[0], SIZE[1]))).expect("memory");
        let screens = Screens::new(host, &context, SIZE);
        let (placed, settings, before) = ([Placed::from(&scene)], RenderSettings::default(), parallel(&view));
        let motion = Some(screens.motion(&before));
        let frame = RecordedFrame { motion, ..RecordedFrame::new(&placed, &view, &settings) };
        let in_flight = crate::host::InFlight::new(host).expect("a command buffer");
        in_flight.begin(host).expect("recording");
        let refused = renderer.record(adopt(&context, &in_flight), 0, &frame);
        let error = refused.map_or_else(|error| error.to_string(), |_| "accepted".into());
        assert_eq!(error, "Reservation::orthographic: not reserved, and the frame needs it");
        in_flight.destroy(host);
        screens.destroy();
    });
}

/// The previous camera stood among the Gaussians. Those behind it have no motion. The motion of those near its plane
/// is at most the picture's size.
#[test]
fn gaussians_that_the_earlier_camera_did_not_see_do_not_outweigh_others() {
    with_host(&options(), |host| {
        let context = guest(host);
        let view = camera(0.3, SIZE[0], SIZE[1]);
        let before = shifted(&view, [0.0, 0.0, 4.0]);
        let part = round(400, 7);
        let scene = DeviceScene::upload(&context, &part, 0).expect("a scene");
        let mut renderer = Renderer::new(&context).expect("kernels");
        renderer.reserve(&both(Reservation::new(400, 0, SIZE[0], SIZE[1]))).expect("memory");
        let screens = Screens::new(host, &context, SIZE);
        let (placed, settings) = ([Placed::from(&scene)], RenderSettings::default());
        let shot = screens.shot(&mut renderer, &RecordedFrame::new(&placed, &view, &settings), &before);
        let truth = Truth::new(&[(0, &part, Pose::IDENTITY, Pose::IDENTITY)], [&view, &before]);
        let count =
            |is: &dyn Fn([f64; 2]) -> bool| truth.who.iter().filter(|(.., motion)| is(*motion)).count();
        let [w, h] = SIZE.map(f64::from);
        let (unknown, cut) = (count(&|m| m == [0.0; 2]), count(&|[x, y]| x.abs() == w || y.abs() == h));
        assert!(unknown > 100 && cut > 20, "{unknown} behind, {cut} cut");
        assert!(truth.check(&shot, SIZE) > 1500);
        assert!(shot.picks.iter().any(|pick| pick[1] != NOT_PICKED));
        assert!(shot.motions.iter().all(|[x, y]| f64::from(x.abs()) <= w && f64::from(y.abs()) <= h));
        screens.destroy();
    });
}
