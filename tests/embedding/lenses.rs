//! Hosts whose cameras have a lens.

use crate::stage::*;
use ashsplat::scene::{Intrinsics, Projection, Readout, Shutter};

const SIZE: [u32; 2] = [112, 56];

/// A frame through a lens or a rolling shutter equals [`Renderer::render`] to the bit. So does a pinhole frame in the same
/// reservation. A batch of scenes equals the same scenes drawn singly. A lens or shutter that is not reserved is refused.
#[test]
fn a_hosts_lens_draws_what_the_owned_path_draws() {
    with_guest(|host, context| {
        let gaussians = cloud(600, 11);
        let scene = uploaded(&context, &gaussians);
        let apart: Vec<_> = (0..9).map(|_| uploaded(&context, &gaussians)).collect();
        let [width, height] = SIZE;
        let pinhole = Camera {
            translation: Vec3::new(0.2, -0.1, 0.4),
            ..Camera::look_at(Vec3::ZERO, Vec3::Z, Vec3::NEG_Y, Intrinsics::from_fov_x(1.2, width, height))
        };
        let wide = Camera { fx: 30.0, fy: 31.0, ..pinhole };
        let (turn, shift) = (Vec3::new(0.04, 0.1, -0.05), Vec3::new(0.1, -0.05, 0.08));
        let shutter = Shutter { readout: Readout::Down, turn, shift };
        let cameras = [
            pinhole.with_lens(Projection::Brown, &[-0.15, 0.02, 0.002, -0.001]),
            wide.with_lens(Projection::Fisheye, &[-0.02, 0.003]),
            pinhole.with_colmap_lens(17, &[112.0, 56.0]).expect("a panorama"),
            Camera { shutter: Some(shutter), ..pinhole },
            Camera { shutter: Some(Shutter { readout: Readout::Right, ..shutter }), ..wide }
                .with_lens(Projection::Fisheye, &[-0.02, 0.003]),
        ];
        let plain = Reservation { scenes: 9, ..Reservation::new(5400, 1, width, height) };
        for camera in cameras {
            let lens = Some(camera.projection).filter(|projection| projection.is_lens());
            let wanted = Reservation { lens, rolling_shutter: camera.shutter.is_some(), ..plain };
            let mut renderer = reserved(&context, &wanted);
            let placed = [Placed::from(&scene)];
            let frame = frame_of(&placed, &camera);
            assert_drawn(host, &mut renderer, &frame, &gaussians);
            assert_drawn(host, &mut renderer, &frame_of(&placed, &pinhole), &gaussians);
            // Scenes in one buffer are a batch, scenes in buffers of their own are not.
            let pose = |index: usize| Pose {
                translation: Vec3::new(0.3 * index as f32, 0.1, 0.0),
                ..Pose::IDENTITY
            };
            let batch: Vec<_> = (0..9).map(|index| Placed::at(&scene, pose(index))).collect();
            let single: Vec<_> =
                apart.iter().enumerate().map(|(index, scene)| Placed::at(scene, pose(index))).collect();
            let [batch, single] =
                [batch, single].map(|placed| rendered(host, &mut renderer, &frame_of(&placed, &camera)));
            assert!(batch == single, "the batch differs from its scenes: {camera:?}");
            renderer.reserve(&plain).expect("memory");
            let commands = Commands::new(host);
            let recorded = renderer.record(commands.begun(renderer.context()), 0, &frame);
            let error = recorded.expect_err("no lens is reserved").to_string();
            let field = if lens.is_some() { "lens" } else { "rolling_shutter" };
            assert!(error.contains(field) && error.contains("not reserved"), "{error}");
            commands.finish();
        }
    });
}
