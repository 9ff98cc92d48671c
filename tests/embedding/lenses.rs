//! Hosts whose cameras have a lens.

use crate::stage::*;
use ashsplat::scene::{Intrinsics, Projection, Readout, Shutter};

const SIZE: [u32; 2] = [112, 56];

/// Frames equal [`Renderer::render`] to the bit, beside pinholes in the same reservation, alone and as a batch of scenes. A lens
/// must be reserved.
#[test]
fn a_hosts_lens_draws_what_the_owned_path_draws() {
    with_guest(|host, context| {
        let gaussians = cloud(600, 11);
        let scene = uploaded(&context, &gaussians);
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
            let apart = Pose { translation: Vec3::new(0.0, 0.0, 90.0), ..Pose::IDENTITY };
            let batch: Vec<Placed<'_>> = (0..9)
                .map(|index| if index == 4 { Placed::from(&scene) } else { Placed::at(&scene, apart) })
                .collect();
            rendered(host, &mut renderer, &frame_of(&batch, &camera));
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
