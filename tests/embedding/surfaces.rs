//! Normals and depths of surfaces in recorded frames, compared with those of frames that are waited for.

use crate::auxiliary::truth::Screens;
use crate::scene_settings::HIDDEN;
use crate::scenes::{joined, similarity};
use crate::stage::*;
use ashsplat::vk::SURFACE_FORMATS;
use ashsplat::{SurfaceDepth, SurfaceTarget};
use half::f16;

const SIZE: [u32; 2] = [110, 70];

/// Two scenes, one of them with a pose, beside hidden ones of the same buffer, which would otherwise be drawn in batches.
#[test]
fn recorded_surfaces_equal_those_of_waited_frames() {
    with_guest(|host, context| {
        let view = camera(0.7, SIZE[0], SIZE[1]);
        let (object, other) = (cloud(400, 8), cloud(300, 9));
        let scenes = [&object, &other].map(|gaussians| uploaded(&context, gaussians));
        let (turn, shift, scale) = (Quat::from_rotation_z(0.5), Vec3::new(0.3, -0.2, 0.5), 1.25);
        let pose = Pose { world_from_object: Mat3::from_quat(turn), translation: shift, scale };
        let both = joined(&object, &similarity(turn, scale, shift), &other);
        let mut placed = vec![Placed::at(&scenes[0], pose), Placed::from(&scenes[1])];
        placed.extend([Placed { settings: HIDDEN, ..Placed::from(&scenes[1]) }; 10]);
        let frame = frame_of(&placed, &view);
        for depth in [SurfaceDepth::Median, SurfaceDepth::Front] {
            let settings = RenderSettings { surface: Some(depth), ..*SETTINGS };
            let expected = owned(&both, &view, &settings).surface.expect("a surface");
            let wanted = Reservation::new(700, 1, SIZE[0], SIZE[1]);
            let wanted = Reservation { scenes: 12, surface: Some(depth), ..wanted };
            let mut renderer = reserved(&context, &wanted);
            let plain = rendered(host, &mut renderer, &frame);
            // The picture stays the same, whichever outputs a frame has.
            let screens = Screens::new(host, &context, SIZE);
            let mut all = reserved(&context, &Reservation { pick: true, motion: true, ..wanted });
            let picture =
                Picture::new(host, &context, ("surface", ImageUse::Surface), SURFACE_FORMATS[0], SIZE);
            for outputs in 0..8 {
                let frame = RecordedFrame {
                    pick: (outputs & 1 != 0).then(|| screens.pick()),
                    motion: (outputs & 2 != 0).then(|| screens.motion(&view)),
                    surface: (outputs & 4 != 0).then(|| SurfaceTarget { to: picture.unused(), depth }),
                    ..frame
                };
                assert!(rendered(host, &mut all, &frame) == plain, "outputs {outputs}");
            }
            for format in SURFACE_FORMATS {
                let picture = Picture::new(host, &context, ("surface", ImageUse::Surface), format, SIZE);
                let surface = Some(SurfaceTarget { to: picture.unused(), depth });
                let with_surface = RecordedFrame { surface, ..frame };
                assert!(rendered(host, &mut renderer, &with_surface) == plain, "the picture changes");
                let (texels, tolerance) = match texel_bytes(format) {
                    8 => {
                        let halves: Vec<[u16; 4]> = picture.texture.read(WRITTEN);
                        (
                            halves
                                .into_iter()
                                .map(|texel| texel.map(|bits| f16::from_bits(bits).to_f32()))
                                .collect(),
                            2e-3,
                        )
                    }
                    _ => (picture.texture.read::<[f32; 4]>(WRITTEN), 1e-4),
                };
                let mut covered = 0;
                let mut far = 0;
                for (texel, (normal, z)) in texels.iter().zip(expected.normals.iter().zip(&expected.depth)) {
                    let normal =
                        if *z > 0.0 { view.camera_from_world * Vec3::from(*normal) } else { Vec3::ZERO };
                    let own = Vec3::from_slice(texel);
                    covered += usize::from(texel[3] > 0.0);
                    let near =
                        (own - normal).length() < tolerance && (texel[3] - z).abs() < tolerance * z.max(1.0);
                    far += usize::from(!near);
                }
                // A Gaussian whose pose was applied beforehand is rounded differently, so another one may be the surface.
                assert!(covered > 1000 && far < covered / 100, "{format:?}: {far} of {covered} differ");
            }
        }
    });
}

#[test]
fn bad_surfaces_are_refused_by_name() {
    with_guest(|host, context| {
        let view = camera(0.7, SIZE[0], SIZE[1]);
        let scene = uploaded(&context, &cloud(60, 5));
        let placed = [Placed::from(&scene)];
        let plain = Reservation::new(60, 1, SIZE[0], SIZE[1]);
        let mut renderer = reserved(&context, &plain);
        let picture = Picture::new(host, &context, ("surface", ImageUse::Surface), SURFACE_FORMATS[0], SIZE);
        let target = SurfaceTarget { to: picture.unused(), depth: SurfaceDepth::Median };
        let frame = RecordedFrame { surface: Some(target), ..frame_of(&placed, &view) };
        assert_argument(&refused(host, &mut renderer, &frame), "Reservation::surface: not reserved");
        renderer.reserve(&Reservation { surface: Some(SurfaceDepth::Front), ..plain }).expect("memory");
        assert_argument(
            &refused(host, &mut renderer, &frame),
            "surface.depth: is Median, and Front is reserved",
        );
        let color = picture.texture.adopt(&context, "color", ImageUse::Target);
        let target = SurfaceTarget { depth: SurfaceDepth::Front, ..target };
        let both = RecordedFrame {
            target: into(&color, Background::Nothing, [0; 2]),
            surface: Some(target),
            ..frame_of(&placed, &view)
        };
        assert_argument(&refused(host, &mut renderer, &both), "is also its target");
        let settings = RenderSettings { surface: Some(SurfaceDepth::Front), ..*SETTINGS };
        let frame = RecordedFrame { settings: &settings, ..frame_of(&placed, &view) };
        assert_argument(
            &refused(host, &mut renderer, &frame),
            "settings.surface: give RecordedFrame::surface",
        );
    });
}
