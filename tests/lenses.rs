//! Cameras with a lens or a rolling shutter: parts of pictures, scenes on all sides, training, and refusals. Golden vectors
//! judge their pictures and gradients (tests/golden/lenses.rs).

use crate::common::engine;
use crate::common::prelude::*;
use crate::common::splats::{ball, camera};
use crate::common::training::{psnr, without_rates};
use ashsplat::scene::{Intrinsics, PhotoLens, Projection, Readout, Shutter, Twist};
use glam::vec3;

/// Camera with a lens, in the middle of [`ball`], and the number of the lens's coefficients.
fn through(projection: Projection) -> (Camera, usize) {
    let (focal, coefficients): (f32, &[f32]) = match projection {
        Projection::Perspective | Projection::Orthographic => (70.0, &[]),
        Projection::Brown => (70.0, &[-0.2, 0.03, 0.004, -0.003, 0.0, 0.0, 0.0, 0.0, 0.0]),
        Projection::Fov => (60.0, &[0.9]),
        Projection::Division => (60.0, &[-0.2]),
        Projection::Eucm => (60.0, &[0.6, 1.1]),
        Projection::Fisheye => (24.0, &[-0.02, 0.004, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]),
        Projection::ThinPrismFisheye => {
            (30.0, &[-0.02, 0.003, 0.0, 0.0, 0.0, 0.0, 0.002, -0.003, 0.004, 0.0, 0.0, 0.0])
        }
        Projection::Equirectangular => (0.0, &[]),
    };
    let inside = |width: u32| {
        let [cx, cy] = [0.5 * width as f32, 32.0];
        Camera { width, height: 64, cx, cy, translation: Vec3::new(0.1, -0.2, 0.3), ..camera(0.3) }
    };
    let camera = match projection {
        Projection::Equirectangular => inside(128).with_colmap_lens(17, &[128.0, 64.0]).expect("a panorama"),
        _ => Camera { fx: focal, fy: focal, ..inside(96) }.with_lens(projection, coefficients),
    };
    (camera, coefficients.len())
}

fn lenses() -> impl Iterator<Item = Projection> {
    Projection::ALL.into_iter().filter(|projection| projection.is_lens())
}

fn rolling(readout: Readout, camera: Camera) -> Camera {
    let (turn, shift) = (Vec3::new(0.05, -0.12, 0.08), Vec3::new(0.1, 0.02, -0.06));
    Camera { shutter: Some(Shutter { readout, turn, shift }), ..camera }
}

fn rolling_pinhole() -> Camera {
    rolling(Readout::Down, Camera { fy: 68.0, ..through(Projection::Perspective).0 })
}

/// Cameras of each family, and with a rolling shutter.
fn cameras() -> impl Iterator<Item = Camera> {
    let shutters = [rolling(Readout::Left, through(Projection::Fisheye).0), rolling_pinhole()];
    lenses().map(|lens| through(lens).0).chain(shutters)
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
    let (panorama, _) = through(Projection::Equirectangular);
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
    let [(brown, _), (panorama, _)] = [Projection::Brown, Projection::Equirectangular].map(through);
    let pinhole = rolling_pinhole();
    let says = |camera: Camera, words: &[&str]| assert_says(refusal(camera.check()), words);
    says(brown.with_lens(Projection::Brown, &[-2.0]), &["folds the picture within the image"]);
    says(brown.with_lens(Projection::Brown, &[f32::NAN]), &["coefficients", "brown has 9"]);
    says(brown.with_lens(Projection::Fov, &[0.9, 1.0]), &["fov has 1"]);
    says(Camera { projection: Projection::Perspective, ..brown }, &["perspective has 0"]);
    says(Camera { height: 60, ..panorama }, &["128x60", "2:1"]);
    says(Camera { fx: 30.0, ..panorama }, &["all around"]);
    let rolling = Camera { shutter: pinhole.shutter, ..brown };
    says(Camera { projection: Projection::Orthographic, ..pinhole }, &["orthographic", "rolling shutter"]);
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
    let lenses = [Projection::Brown, Projection::Division, Projection::Fisheye, Projection::Equirectangular];
    let lenses = lenses.into_iter().map(|lens| through(lens).0);
    let views = photographed(&truth, lenses.chain([rolling_pinhole()]));
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
    // The scene is scaled only if no view is a panorama.
    for views in [&views[..3], &views[..]] {
        Run::shared(views.to_vec(), moved.clone()).starting_at(&start).check_stops(&[&[9]]);
    }
}

/// Left, top, right and bottom of the pixels that [`covering`] covers.
const WINDOW: [u32; 4] = [58, 24, 66, 32];

fn window(camera: &Camera) -> impl Iterator<Item = usize> + use<> {
    let ([left, top, right, bottom], width) = (WINDOW, camera.width);
    (top..bottom).flat_map(move |y| (left..right).map(move |x| (y * width + x) as usize))
}

fn in_camera(camera: &Camera, mean: Vec3) -> Vec3 {
    camera.camera_from_world * mean + camera.translation
}

/// Gaussians that cover the window with alphas far above the cut at 1/255, so that its pixels are smooth functions of all numbers. They
/// are in front of the camera, or close to it on all sides, where Jacobians replace some unscented transforms.
fn covering(renderer: &mut Renderer, camera: &Camera, is_inside: bool) -> Gaussians {
    const COUNT: usize = 6;
    let mut random = Random::new(5);
    let [left, top, ..] = WINDOW.map(f64::from);
    let points = camera.points();
    let mut all = Vec::new();
    for _ in 0..4000 {
        let (mut gaussian, far) = (gaussian(&mut random, 1.0, [-1.2, -0.1], 4), random.between(1.0, 4.0));
        let mean = match is_inside {
            true => camera.position() + Vec3::from(gaussian.mean.map(|x| x as f32)),
            false => {
                let position = [left + random.between(-2.0, 10.0), top + random.between(-2.0, 10.0)];
                gaussian.log_scale = gaussian.log_scale.map(|scale| scale + far.ln() - 1.1);
                points(position.map(|x| x as f32), far as f32)
            }
        };
        gaussian.mean = mean.to_array().map(f64::from);
        gaussian.opacity_logit = random.between(-1.0, 0.5);
        // No colour is held at 0.
        gaussian.sh[0] = gaussian.sh[0].map(f64::abs);
        renderer.upload(&engine::gaussians(std::slice::from_ref(&gaussian))).expect("uploaded");
        let frame = renderer.render(camera, &RenderSettings::default()).expect("a frame");
        // The order of depths jumps, and so does what the near plane cuts off.
        let depth = camera.projection.depth_of(in_camera(camera, mean).as_dvec3());
        let is_apart = all.iter().all(|&(_, other): &(Gaussian, f64)| (depth / other - 1.0).abs() > 0.06);
        if depth > 0.3 && is_apart && window(camera).all(|pixel| 1.0 - frame.transmittance[pixel] > 0.02) {
            all.push((gaussian, depth));
        }
        if all.len() == COUNT {
            return engine::gaussians(&all.into_iter().map(|(gaussian, _)| gaussian).collect::<Vec<_>>());
        }
    }
    panic!("{:?}: {} Gaussians cover the window", camera.projection, all.len());
}

/// A number by which a picture is differentiated.
#[derive(Clone, Copy, Debug)]
enum Number {
    /// A focal length, a coordinate of the principal point, or a coefficient.
    Lens(usize),
    Pose(usize),
    Mean(usize),
}

impl Number {
    /// Largest step: pixels, coefficients, units of the scene or radians.
    fn step(self) -> f64 {
        match self {
            Number::Lens(0..4) => 0.5,
            Number::Lens(_) => 4e-3,
            Number::Pose(_) | Number::Mean(_) => 0.01,
        }
    }

    fn add(self, by: f64, camera: &mut Camera, scene: &mut Gaussians) {
        match self {
            Number::Lens(index) => {
                let Camera { fx, fy, cx, cy, coefficients, .. } = camera;
                *[fx, fy, cx, cy].into_iter().chain(coefficients).nth(index).expect("a parameter") +=
                    by as f32;
            }
            Number::Pose(index) => {
                let (turn, shift) =
                    Twist::from_array(std::array::from_fn(|k| if k == index { by } else { 0.0 })).exp();
                camera.camera_from_world = (turn * camera.camera_from_world.as_dmat3()).as_mat3();
                camera.translation = (turn * camera.translation.as_dvec3() + shift).as_vec3();
            }
            Number::Mean(index) => scene.means.as_flattened_mut()[index] += by as f32,
        }
    }
}

/// Compares gradients with extrapolated central differences (Richardson) of several steps: a large one may change which points of an
/// unscented transform are shown, a small one leaves float32's rounding.
fn compare(
    renderer: &mut Renderer,
    camera: &Camera,
    scene: &Gaussians,
    numbers: impl Iterator<Item = Number>,
) {
    let settings = RenderSettings::default();
    let mut weights = vec![[0.0; 3]; (camera.width * camera.height) as usize];
    for pixel in window(camera) {
        let [x, y] = [pixel as u32 % camera.width, pixel as u32 / camera.width].map(|x| 0.2 * x as f32);
        weights[pixel] = [(x + 0.5 * y).sin(), (y - 1.5 * x).cos(), (0.2 * x * y).sin()];
    }
    renderer.upload(scene).expect("uploaded");
    let gradients = renderer.gradients_with_pose(camera, &settings, &weights, None).expect("gradients");
    for number in numbers {
        let derivative = match number {
            Number::Lens(index) => gradients.lens.expect("a lens")[index],
            Number::Pose(index) => gradients.pose.expect("a pose")[index].into(),
            Number::Mean(index) => gradients.parameters.means.as_flattened()[index].into(),
        };
        let moved = |by: f64| {
            let (mut camera, mut scene) = (*camera, scene.clone());
            number.add(by, &mut camera, &mut scene);
            (camera, scene)
        };
        let mut loss = |by: f64| -> f64 {
            let (camera, scene) = moved(by);
            renderer.upload(&scene).expect("uploaded");
            let color = renderer.render(&camera, &settings).expect("a frame").color;
            let products = color.as_flattened().iter().zip(weights.as_flattened());
            products.map(|(color, weight)| f64::from(*color) * f64::from(*weight)).sum()
        };
        let mut tried = Vec::new();
        let agrees = [1.0, 0.3, 0.1, 0.03].into_iter().any(|share| {
            let step = share * number.step().min(0.2 / derivative.abs());
            if [-2.0, 2.0].into_iter().any(|steps| moved(steps * step).0.check().is_err()) {
                return false;
            }
            let [near, far] = [step, 2.0 * step].map(|step| loss(step) - loss(-step));
            let difference = (8.0 * near - far) / (12.0 * step);
            tried.push((step, difference));
            (difference - derivative).abs() < 2e-3 * derivative.abs() + 2e-5 / step
        });
        let projection = camera.projection;
        assert!(agrees, "{projection:?} {number:?}: {derivative}, by differences (step, value) {tried:?}");
    }
}

/// The limit at which Jacobians are held depends on the lens, and counts as a constant in its gradient. So Gaussians beyond it are left
/// out there.
#[test]
fn gradients_through_lenses_are_those_of_differences() {
    let mut renderer = renderer();
    for (lens, is_inside) in lenses().flat_map(|lens| [false, true].map(|is_inside| (lens, is_inside))) {
        let (camera, coefficients) = through(lens);
        let scene = covering(&mut renderer, &camera, is_inside);
        let means = (0..3 * scene.len()).step_by(16).map(Number::Mean);
        compare(&mut renderer, &camera, &scene, (0..6).map(Number::Pose).chain(means));
        let Some(([_, hold, ..], _)) = camera.lens_words().filter(|_| coefficients > 0) else { continue };
        let is_held = |index: &usize| {
            let at = in_camera(&camera, Vec3::from(scene.means[*index]));
            !lens.orders_by_distance() && at.truncate().length() > hold * at.z
        };
        let others: Vec<usize> = (0..scene.len()).filter(|index| !is_held(index)).collect();
        // From inside, other coefficients move points of the transform by whole pictures.
        let is_compared = |k: &usize| !is_inside || *k < 4 || camera.coefficients[k - 4] != 0.0;
        let numbers = (0..4 + coefficients).filter(is_compared).map(Number::Lens);
        compare(&mut renderer, &camera, &scene.select(&others), numbers);
    }
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

/// Lenses of two families, with focal lengths off by 2 % and distortions off by 0.02, return to the true values, also if the scene
/// was fitted to them in size. A pinhole learns its distortion.
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
    let steps = |views: Vec<TrainView>, scene: &Gaussians| {
        let settings = TrainSettings {
            iterations: 1500,
            strategy: StrategyType::Fixed,
            lens_opt: true,
            lens_opt_lr: 5e-3,
            sh_degree: 0,
            ..TrainSettings::reference()
        };
        let settings = without_rates(settings);
        let mut trainer = Trainer::new(context(), views, scene, 2.0, settings).expect("a trainer");
        trainer.steps(1500);
        // Lenses of no training view change with the scene's size only.
        let zoom = trainer.with_trained_lens(&Camera { width: 90, ..own[0] }).fx / own[0].fx;
        (trainer.cameras().expect("cameras"), zoom)
    };
    let mut small = scene.clone();
    small.means.iter_mut().flatten().for_each(|value| *value /= 1.02);
    small.log_scales.iter_mut().flatten().for_each(|value| *value -= 1.02_f32.ln());
    for (start, expected_zoom) in [(&scene, 1.0), (&small, 1.0 / 1.02)] {
        let given = photographed(&scene, own.iter().copied())
            .into_iter()
            .map(|view| TrainView::new(off(&view.camera), view.photo));
        let (cameras, zoom) = steps(given.collect(), start);
        assert!((zoom - expected_zoom).abs() < 2e-3, "{zoom}, not {expected_zoom}");
        for (found, own) in cameras.iter().zip(&own) {
            let [focal, k1] = [found.fx / own.fx - 1.0, found.coefficients[0] - own.coefficients[0]];
            assert!(focal.abs() < 1e-3 && k1.abs() < 1e-3, "{:?}: {focal} and {k1} are left", own.projection);
        }
    }
    let pinholes = photographed(&scene, own[..3].iter().copied()).into_iter().map(|view| {
        let pinhole = Camera { projection: Projection::Perspective, coefficients: [0.0; 12], ..view.camera };
        TrainView::new(pinhole, view.photo)
    });
    let found = steps(pinholes.collect(), &scene).0[0];
    let k1 = found.coefficients[0] - own[0].coefficients[0];
    assert!(found.projection == Projection::Brown && k1.abs() < 0.01, "{:?}", found.coefficients);
}

fn photo_of(view: &TrainView) -> Photo {
    let texels = view.photo.texels().expect("texels");
    let rgb = texels.as_chunks::<4>().0.iter().flat_map(|&[r, g, b, _]| [r, g, b]).collect();
    Photo { width: view.photo.width, height: view.photo.height, rgb }
}
