//! Cameras with a lens or a rolling shutter: parts of pictures, scenes on all sides, training, and refusals. Golden vectors
//! judge their pictures and gradients (tests/golden/lenses.rs).

use crate::common::prelude::*;
use crate::common::splats::{ball, camera};
use crate::common::training::{psnr, without_rates};
use ashsplat::scene::{Intrinsics, PhotoLens, Projection, Readout, Shutter};
use glam::vec3;

/// Cameras of each family, in the middle of [`ball`].
fn cameras() -> Vec<Camera> {
    let inside = |camera: Camera| Camera { translation: Vec3::new(0.1, -0.2, 0.3), ..camera };
    let [wide, around] = [(96, 64), (128, 64)].map(|(width, height)| {
        inside(Camera { width, height, cx: 0.5 * width as f32, cy: 0.5 * height as f32, ..camera(0.3) })
    });
    let lenses: [(Projection, f32, &[f32]); 6] = [
        (Projection::Brown, 70.0, &[-0.2, 0.03, 0.004, -0.003]),
        (Projection::Fov, 60.0, &[0.9]),
        (Projection::Division, 60.0, &[-0.2]),
        (Projection::Eucm, 60.0, &[0.6, 1.1]),
        (Projection::Fisheye, 24.0, &[-0.02, 0.004]),
        (Projection::ThinPrismFisheye, 30.0, &[-0.02, 0.003, 0.0, 0.0, 0.0, 0.0, 0.002, -0.003, 0.004]),
    ];
    let with = |(projection, focal, coefficients): (Projection, f32, &[f32])| {
        Camera { fx: focal, fy: focal, ..wide }.with_lens(projection, coefficients)
    };
    let panorama = around.with_colmap_lens(17, &[128.0, 64.0]).expect("a panorama");
    let with_lenses: Vec<Camera> = lenses.into_iter().map(with).chain([panorama]).collect();
    let (turn, shift) = (Vec3::new(0.05, -0.12, 0.08), Vec3::new(0.1, 0.02, -0.06));
    let rolling = |readout, camera| Camera { shutter: Some(Shutter { readout, turn, shift }), ..camera };
    let pinhole = Camera { fx: 70.0, fy: 68.0, ..wide };
    let shutters = [rolling(Readout::Left, with_lenses[4]), rolling(Readout::Down, pinhole)];
    with_lenses.into_iter().chain(shutters).collect()
}

/// Positions and depths in a picture lead back to the points shown there, also for parts and rolling shutters.
#[test]
fn a_pictures_places_are_those_of_its_points() {
    for camera in cameras() {
        let part = camera.part([7, 5], [60, 50]).expect("a part");
        let mut shown = 0;
        for point in ball(300).means.iter().map(|mean| Vec3::from_array(*mean)).filter(|p| part.sees(*p)) {
            let (x, y, depth) = part.project(point);
            let back = part.points()([x, y], depth);
            // The time at which a row is read is found to some hundredths of a pixel.
            let close = if camera.shutter.is_some() { 2e-3 } else { 2e-5 };
            assert!(back.abs_diff_eq(point, close * depth), "{camera:?}: {point} comes back as {back}");
            let (left, top, _) = camera.project(point);
            assert!((left - 7.0 - x).abs() < 1e-3 && (top - 5.0 - y).abs() < 1e-3, "{camera:?}: {point}");
            shown += 1;
        }
        assert!(shown > 10, "{camera:?} shows {shown} points");
    }
}

/// A part's tiles differ from those of the whole, and a panorama's seam lies inside the part or outside.
#[test]
fn a_part_of_a_lenss_picture_has_the_pixels_of_the_whole() {
    let mut renderer = renderer();
    renderer.upload(&ball(500)).expect("uploaded");
    let settings = RenderSettings { inverse_depth: true, ..RenderSettings::default() };
    for camera in cameras() {
        let whole = renderer.render(&camera, &settings).expect("a frame");
        assert!(whole.color.as_flattened().iter().all(|c| c.is_finite()), "{:?}", camera.projection);
        assert!(whole.transmittance.iter().any(|&t| t < 0.1), "{:?} shows nothing", camera.projection);
        let right = camera.width - 21;
        for ([left, top], [width, height]) in
            [([0, 0], [37, 64]), ([right, 3], [21, 50]), ([19, 17], [60, 40])]
        {
            let part = camera.part([left, top], [width, height]).expect("a part");
            let frame = renderer.render(&part, &settings).expect("a frame");
            for (pixel, color) in frame.color.iter().enumerate() {
                let [x, y] = [left + pixel as u32 % width, top + pixel as u32 / width];
                let expected = whole.color[(y * camera.width + x) as usize];
                let off = (Vec3::from(*color) - Vec3::from(expected)).abs().max_element();
                assert!(off < 2e-4, "{:?}: ({x}, {y}) is off by {off}", camera.projection);
            }
        }
    }
}

/// Turning a panorama about the vertical axis shifts its picture, also across the seam.
#[test]
fn a_turned_panorama_is_moved_through_its_seam() {
    let panorama = cameras()[6];
    let mut renderer = renderer();
    renderer.upload(&ball(400).with_sh_degree(0)).expect("uploaded");
    let [straight, turned] = [0.0, std::f32::consts::PI / 2.0].map(|angle| {
        let turn = glam::Mat3::from_rotation_y(angle);
        let camera = Camera {
            camera_from_world: turn * panorama.camera_from_world,
            translation: turn * panorama.translation,
            ..panorama
        };
        renderer.render(&camera, &RenderSettings::default()).expect("a frame").color
    });
    let (width, quarter) = (panorama.width as usize, panorama.width as usize / 4);
    let mut far = 0;
    for (pixel, color) in turned.iter().enumerate() {
        let (x, y) = (pixel % width, pixel / width);
        let before = straight[y * width + (x + width - quarter) % width];
        far += usize::from((Vec3::from(*color) - Vec3::from(before)).abs().max_element() > 1e-3);
    }
    // A Gaussian ends half a picture away from its centre, which is another pixel in each picture.
    assert!(far < turned.len() / 200, "{far} of {} pixels differ", turned.len());
}

#[test]
fn lenses_without_a_picture_are_refused() {
    let all = cameras();
    let (brown, panorama) = (all[0], all[6]);
    let says = |camera: Camera, words: &[&str]| assert_says(refusal(camera.check()), words);
    says(brown.with_lens(Projection::Brown, &[-2.0]), &["folds the picture within the image"]);
    says(brown.with_lens(Projection::Brown, &[f32::NAN]), &["coefficients", "brown has 9"]);
    says(brown.with_lens(Projection::Fov, &[0.9, 1.0]), &["fov has 1"]);
    says(Camera { projection: Projection::Perspective, ..brown }, &["perspective has 0"]);
    says(Camera { height: 60, ..panorama }, &["128x60", "2:1"]);
    says(Camera { fx: 30.0, ..panorama }, &["all around"]);
    let rolling = Camera { shutter: all[8].shutter, ..brown };
    says(Camera { projection: Projection::Orthographic, ..all[8] }, &["orthographic", "rolling shutter"]);
    let shutter = rolling.shutter.map(|shutter| Shutter { shift: Vec3::NAN, ..shutter });
    says(Camera { shutter, ..rolling }, &["motion of the shutter"]);
    assert!(brown.with_colmap_lens(4, &[1.0; 7]).is_none() && brown.with_colmap_lens(18, &[]).is_none());
    let undistorted = brown.with_lens(Projection::Brown, &[0.0; 8]);
    assert_eq!(undistorted.projection, Projection::Perspective);
    assert_eq!(PhotoLens::panorama(128, 64).intrinsics(), panorama.intrinsics());
}

/// Trains photographs of several lenses together, with both filters: each view comes closer to its photograph. Resumed runs
/// have the same bits, also with moved poses and more Gaussians.
#[test]
fn photographs_are_learned_through_their_lenses() {
    let truth = ball(120).with_sh_degree(0);
    let views = photographed(&truth, cameras().into_iter().step_by(2));
    let mut start = truth.clone();
    start.sh.iter_mut().for_each(|color| *color = color.map(|c| 0.3 * c + 0.1));
    let settings = TrainSettings {
        iterations: 70,
        feature_lr: 0.02,
        opacity_reset_interval: 3000,
        antialiasing: true,
        filter_3d: true,
        densify_until_iter: 1,
        random_background: false,
        ..crate::common::training::settings()
    };
    let mut trainer = Run::shared(views.clone(), settings.clone()).starting_at(&start).begin();
    let likeness = |trainer: &mut Trainer| -> Vec<f64> {
        let each = |view: &TrainView| {
            let shown = [(view.camera, photo_of(view))];
            psnr(trainer, shown.into_iter())
        };
        views.iter().map(each).collect()
    };
    let before = likeness(&mut trainer);
    trainer.finish();
    let after = likeness(&mut trainer);
    for ((view, before), after) in views.iter().zip(before).zip(after) {
        assert!(after > before + 2.0, "{:?}: {before} dB, then {after} dB", view.camera.projection);
    }
    drop(trainer);
    let surface = TrainSettings { surface: true, ..settings.clone() };
    let refused = refusal(Run::shared(views.clone(), surface).starting_at(&start).try_begin());
    assert_says(refused, &["surface", "pinholes", "--undistort"]);
    let moved =
        TrainSettings { iterations: 20, pose_opt: true, lens_opt: true, densify_until_iter: 19, ..settings };
    Run::shared(views, moved).starting_at(&start).check_stops(&[&[9]]);
}

/// Views of a scene with their photographs.
pub fn photographed(scene: &Gaussians, cameras: impl Iterator<Item = Camera>) -> Vec<TrainView> {
    let mut renderer = loaded(context(), scene);
    let take = |camera: Camera| {
        let frame = renderer.render(&camera, &RenderSettings::default()).expect("a frame");
        let byte = |value: &f32| (255.0 * value.clamp(0.0, 1.0)).round() as u8;
        let rgb = frame.color.as_flattened().iter().map(byte).collect();
        TrainView::new(camera, Photo { width: frame.width, height: frame.height, rgb })
    };
    cameras.map(take).collect()
}

/// Lenses of two families, with focal lengths off by 2 % and distortions off by 0.02, return to the true values. A pinhole
/// learns its distortion.
#[test]
fn lenses_are_found_again_on_a_scene_that_is_known() {
    let scene = ball(400).with_sh_degree(0);
    let own: Vec<Camera> = [(Projection::Brown, 60.0, 2.2), (Projection::Fisheye, 36.0, 1.6)]
        .into_iter()
        .flat_map(|lens| (0..3).map(move |turn| (lens, turn)))
        .map(|((lens, focal, distance), turn)| {
            let intrinsics = Intrinsics { fx: focal, fy: focal, cx: 40.0, cy: 30.0, width: 80, height: 60 };
            let angle = turn as f32;
            let eye = vec3(distance * angle.cos(), 0.3 * angle, distance * angle.sin());
            Camera::look_at(eye, Vec3::ZERO, Vec3::NEG_Y, intrinsics).with_lens(lens, &[-0.1, 0.02])
        })
        .collect();
    let off = |camera: &Camera| {
        let coefficients = [camera.coefficients[0] + 0.02, camera.coefficients[1]];
        let moved = Camera { fx: 1.02 * camera.fx, fy: 1.02 * camera.fy, ..*camera };
        moved.with_lens(camera.projection, &coefficients)
    };
    let steps = |views: Vec<TrainView>| {
        let settings = TrainSettings {
            iterations: 600,
            strategy: StrategyType::Fixed,
            lens_opt: true,
            lens_opt_lr: 5e-3,
            sh_degree: 0,
            ..TrainSettings::reference()
        };
        let settings = without_rates(settings);
        let mut trainer = Trainer::new(context(), views, &scene, 2.0, settings).expect("a trainer");
        trainer.steps(600);
        trainer.cameras().expect("cameras")
    };
    let given = photographed(&scene, own.iter().copied())
        .into_iter()
        .map(|view| TrainView::new(off(&view.camera), view.photo))
        .collect();
    for (found, own) in steps(given).iter().zip(&own) {
        let [focal, k1] = [found.fx / own.fx - 1.0, found.coefficients[0] - own.coefficients[0]];
        assert!(focal.abs() < 1e-3 && k1.abs() < 1e-3, "{:?}: {focal} and {k1} are left", own.projection);
    }
    let pinholes = photographed(&scene, own[..3].iter().copied()).into_iter().map(|view| {
        let pinhole = Camera { projection: Projection::Perspective, coefficients: [0.0; 12], ..view.camera };
        TrainView::new(pinhole, view.photo)
    });
    let found = steps(pinholes.collect())[0];
    let k1 = found.coefficients[0] - own[0].coefficients[0];
    assert!(found.projection == Projection::Brown && k1.abs() < 0.01, "{:?}", found.coefficients);
}

fn photo_of(view: &TrainView) -> Photo {
    let texels = view.photo.texels().expect("texels");
    let rgb = texels.as_chunks::<4>().0.iter().flat_map(|&[r, g, b, _]| [r, g, b]).collect();
    Photo { width: view.photo.width, height: view.photo.height, rgb }
}
