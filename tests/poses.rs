//! Gradients of camera poses: finite differences prove the twin, the twin proves the device. Displaced poses are
//! recovered in training and by alignment.

use crate::checkpoints;
use crate::common::blending::assert_alike;
use crate::common::engine::{self, derivatives, settings};
use crate::common::prelude::*;
use crate::common::training::without_rates;
use crate::gradients::{self, decisions, linear_loss, narrow_view, narrowed, random_weights, stable_weights};
use crate::reference::pipeline::{backward, pixels_of, render};
use crate::reference::pose_step::moved;
use ashsplat::Alignment;
use ashsplat::scene::{StoredPhoto, Twist, scene_extent};
use ashsplat::train::OptimizerType;
use glam::DVec3;

/// The view at exp(δ^) T.
pub fn moved_view(view: &View, delta: [f64; 6]) -> View {
    let (camera_from_world, translation) = moved(delta, (&view.camera_from_world, view.translation));
    View { camera_from_world, translation, ..view.clone() }
}

fn along(axis: usize, by: f64) -> [f64; 6] {
    let mut delta = [0.0; 6];
    delta[axis] = by;
    delta
}

/// Compares all six derivatives with central differences. Returns the number compared.
fn compare_with_differences(view: &View, seed: u64) -> usize {
    let mut random = Random::new(seed);
    let scene = small_scene(&mut random, 6, 16);
    let weights = random_weights(&mut random, view);
    let pose = backward(&scene, view, &render(&scene, view), &weights).pose;
    let largest = pose.iter().fold(0.0, |max: f64, x| max.max(x.abs()));
    let bound = |derivative: f64| 1e-6 * largest + 2e-6 * derivative.abs();
    gradients::compare_with_differences(&format!("seed {seed}"), &pose, 1e-6, bound, |axis, by| {
        let view = moved_view(view, along(axis, by));
        (linear_loss(&scene, &view, &weights), decisions(&scene, &view))
    })
}

#[test]
fn poses_of_the_twin_agree_with_finite_differences() {
    for extent in [Extent::Exact, Extent::Reference] {
        for antialias in [false, true] {
            let view = View { extent, antialias, ..small_view([40, 24]) };
            let compared: usize = (0..10).map(|seed| compare_with_differences(&view, seed)).sum();
            assert!(compared > 20, "only {compared} of 60 derivatives could be compared");
        }
    }
    for view in [false, true].map(narrow_view) {
        let compared: usize = (10..20).map(|seed| compare_with_differences(&view, seed)).sum();
        assert!(compared > 20, "only {compared} of 60 derivatives could be compared");
    }
}

fn compare_with_device(renderer: &mut Renderer, view: &View, (count, seed): (usize, u64)) {
    let mut random = Random::new(seed);
    let scene = small_scene(&mut random, count, 16);
    let frame = render(&scene, view);
    let weights = stable_weights(&mut random, view, &frame);
    let expected = backward(&scene, view, &frame, &weights).pose;
    let (color, inverse_depth) = narrowed(&weights);
    renderer.upload(&gaussians(&scene)).expect("upload");
    let (camera, settings) = (camera(view), settings(view));
    let mut gradients =
        || renderer.gradients_with_pose(&camera, &settings, &color, Some(&inverse_depth)).expect("gradients");
    let first = gradients();
    assert!(first == gradients(), "other bits");
    let actual = first.pose.expect("a gradient of the pose").map(f64::from);
    let largest = expected.iter().fold(0.0, |max: f64, x| max.max(x.abs()));
    elementwise("pose", &actual, &expected, 1e-4 * largest, 0.0).expect("the pose's gradient");
    // All other gradients equal those without it.
    let plain = renderer.gradients(&camera, &settings, &color, Some(&inverse_depth)).expect("gradients");
    assert!(plain.pose.is_none());
    for (a, b) in derivatives(&plain).into_iter().zip(derivatives(&first)) {
        assert_alike(renderer.context(), a, b, ("gradients beside the pose's", 1e-5));
    }
}

#[test]
fn poses_of_the_device_agree_with_the_twin() {
    let gpu = Gpu::new();
    let mut renderer = renderer();
    for seed in 0..2 {
        for extent in [Extent::Exact, Extent::Reference] {
            for (antialias, sh_degree) in [(false, 3), (true, 1), (false, 0)] {
                let view = View { extent, antialias, sh_degree, ..small_view([90, 60]) };
                compare_with_device(&mut renderer, &view, (150, 100 + seed));
            }
        }
    }
    drop((renderer, gpu));
}

#[test]
fn poses_of_a_scene_in_several_buffers() {
    let context = with_range(100_000);
    let mut renderer = Renderer::new(&context).expect("a renderer");
    compare_with_device(&mut renderer, &small_view([60, 40]), (1200, 7));
    assert_silent(&context);
}

/// L = Σ pixel · weight with smooth weights, by the public renderer.
fn loss(renderer: &mut Renderer, view: &View, settings: &RenderSettings, weights: &[[f32; 3]]) -> f64 {
    let frame = renderer.render(&camera(view), settings).expect("a frame");
    let terms = frame.color.iter().zip(weights);
    terms.flat_map(|(c, w)| [0, 1, 2].map(|i| f64::from(c[i]) * f64::from(w[i]))).sum()
}

/// The public renderer's pictures change as its gradient predicts, within float32 rounding and the jumps at 1/255.
#[test]
fn poses_agree_with_differences_of_pictures() {
    let gpu = Gpu::new();
    let view = small_view([160, 120]);
    let mut scene: Gaussians = gaussians(&small_scene(&mut Random::new(21), 12, 16));
    // A Gaussian's edge at alpha 1/255 also moves. Opaque Gaussians make its effect small. Their depths are far apart, because
    // the picture jumps when their order changes.
    scene.opacity_logits.iter_mut().for_each(|logit| *logit = logit.max(3.0));
    scene.means.iter_mut().zip(0..).for_each(|(mean, i)| *mean = [mean[0], mean[1], 0.3 * i as f32 - 1.8]);
    let mut renderer = renderer();
    renderer.upload(&scene).expect("upload");
    let settings = RenderSettings { inverse_depth: false, ..settings(&view) };
    let weights: Vec<[f32; 3]> = pixels_of(&view)
        .map(|[x, y]| {
            let (x, y) = (x as f32 / 160.0, y as f32 / 120.0);
            [x * y, (3.0 * x).sin() * y, 1.0 - x]
        })
        .collect();
    let gradients = renderer.gradients_with_pose(&camera(&view), &settings, &weights, None);
    let pose = gradients.expect("gradients").pose.expect("a pose").map(f64::from);
    let largest = pose.iter().fold(0.0, |max: f64, x| max.max(x.abs()));
    let step = 2e-3;
    for (axis, derivative) in pose.into_iter().enumerate() {
        let mut at = |by| loss(&mut renderer, &moved_view(&view, along(axis, by)), &settings, &weights);
        let difference = (at(step) - at(-step)) / (2.0 * step);
        let error = (difference - derivative).abs() / largest;
        assert!(error < 0.02, "axis {axis}: {} by differences, {} as a gradient", difference, derivative);
    }
    drop((renderer, gpu));
}

const SIZE: [u32; 2] = [96, 72];
const VIEWS: u32 = 8;

fn scene() -> Gaussians {
    engine::gaussians(&small_scene(&mut Random::new(41), 150, 4))
}

fn cameras() -> Vec<Camera> {
    let turned = |i: u32| {
        let angle = std::f64::consts::TAU * f64::from(i) / f64::from(VIEWS);
        let camera_from_world = rotation_about_y(angle);
        camera(&View { camera_from_world, translation: [0.0, 0.1, 5.0], ..small_view(SIZE) })
    };
    (0..VIEWS).map(turned).collect()
}

fn extent() -> f32 {
    scene_extent(cameras().iter().map(Camera::position).collect::<Vec<_>>().into_iter())
}

fn photographs() -> Vec<Photo> {
    let mut renderer = engine::renderer();
    renderer.upload(&scene()).expect("upload");
    let photograph = |camera: &Camera| {
        let frame = renderer.render(camera, &RenderSettings::default()).expect("a photograph");
        let byte = |x: &f32| (x * 255.0).round().clamp(0.0, 255.0) as u8;
        let rgb = frame.color.iter().flatten().map(byte).collect();
        Photo { width: SIZE[0], height: SIZE[1], rgb }
    };
    cameras().iter().map(photograph).collect()
}

/// Each camera turned by a degree about some axis, and moved by a hundredth of the extent.
fn perturbed() -> Vec<Camera> {
    let mut random = Random::new(77);
    let mut direction = || {
        let mut axis = || 2.0 * random.unit() - 1.0;
        DVec3::new(axis(), axis(), axis()).normalize()
    };
    let length = 0.01 * f64::from(extent());
    let twist = |_: &Camera| Twist { nu: direction() * length, omega: direction() * 1_f64.to_radians() };
    let twists: Vec<Twist> = cameras().iter().map(twist).collect();
    cameras().iter().zip(twists).map(|(camera, twist)| twist.applied_to(camera)).collect()
}

/// Largest differences between two lists of cameras: degrees, and shares of the extent.
fn apart(cameras: &[Camera], others: &[Camera]) -> (f64, f64) {
    let mut max = (0.0_f64, 0.0_f64);
    for (camera, other) in cameras.iter().zip(others) {
        let turn = camera.camera_from_world.as_dmat3() * other.camera_from_world.as_dmat3().transpose();
        let axis = DVec3::new(
            turn.y_axis.z - turn.z_axis.y,
            turn.z_axis.x - turn.x_axis.z,
            turn.x_axis.y - turn.y_axis.x,
        );
        let angle = (0.5 * axis.length()).asin().to_degrees();
        let distance = camera.exact_position().distance(other.exact_position()) / f64::from(extent());
        max = (max.0.max(angle), max.1.max(distance));
    }
    max
}

fn views(cameras: &[Camera]) -> Vec<TrainView> {
    cameras.iter().zip(photographs()).map(|(&camera, photo)| TrainView::new(camera, photo)).collect()
}

/// Settings for these Gaussians alone.
fn few(iterations: u32) -> TrainSettings {
    TrainSettings {
        iterations,
        sh_degree: 1,
        sh_degree_interval: 1,
        strategy: StrategyType::Fixed,
        ..TrainSettings::reference()
    }
}

/// Settings that keep the scene unchanged.
fn fixed(iterations: u32) -> TrainSettings {
    TrainSettings { pose_opt: true, pose_lr: 1e-2, ..without_rates(few(iterations)) }
}

#[test]
fn poses_are_found_again_on_a_scene_that_is_known() {
    let gpu = Gpu::unchecked();
    let given = &perturbed()[..3];
    let (degrees, share) = apart(given, &cameras());
    assert!((0.99..1.01).contains(&degrees) && (0.009..0.0101).contains(&share), "{degrees}, {share}");
    let mut trainer =
        Trainer::new(gpu.context, views(given), &scene(), extent(), fixed(1500)).expect("a trainer");
    assert_eq!(trainer.cameras().expect("cameras"), given, "nothing has moved yet");
    trainer.steps(1500);
    let (degrees, share) = apart(&trainer.cameras().expect("cameras"), &cameras());
    // With turns about the cameras' centres, 0.015 and 2.2e-4 remain.
    assert!(degrees < 0.011 && share < 1.6e-4, "{degrees} degrees, {share} of the extent");
    assert!(trainer.gaussians().expect("Gaussians") == scene(), "the scene was to stay");
}

#[test]
fn poses_of_held_out_views_are_aligned() {
    let gpu = Gpu::new();
    let (cameras, given) = (cameras(), perturbed());
    let photos: Vec<StoredPhoto> = photographs().into_iter().map(Into::into).collect();
    let alignment = Alignment::default();
    let settings = RenderSettings::default();
    let mut trainer =
        Trainer::new(gpu.context, views(&cameras), &scene(), extent(), fixed(10)).expect("a trainer");
    trainer.step().expect("a step");
    let before = trainer.state();
    let at_degree = trainer.at_current_degree(&settings);
    let align = |(camera, photo)| {
        trainer.draw(|renderer| renderer.align(camera, photo, &at_degree, &alignment)).expect("aligned")
    };
    let aligned: Vec<Camera> = given.iter().zip(&photos).take(3).map(align).collect();
    let (degrees, share) = apart(&aligned, &cameras);
    assert!(degrees < 0.15 && share < 2e-3, "{degrees} degrees, {share} of the extent");
    assert!(trainer.state() == before, "training has changed");
    // A renderer gives the same result.
    let mut renderer = engine::renderer();
    renderer.upload(&scene()).expect("upload");
    let alone = renderer.align(&given[0], &photos[0], &settings, &alignment).expect("aligned");
    assert_eq!(alone, aligned[0]);
    // A fully masked photograph moves nothing.
    let photo = photos[0].photo().expect("a photo");
    let hidden = StoredPhoto::new((*photo).clone(), Some(vec![0; (SIZE[0] * SIZE[1]) as usize]));
    let unmoved = renderer.align(&given[0], &hidden, &settings, &alignment).expect("aligned");
    assert_eq!(unmoved, given[0]);
    let smaller = given[0].scaled_to(48, 36);
    let error = renderer.align(&smaller, &photos[0], &settings, &alignment).expect_err("refused");
    assert!(error.to_string().contains("96x72 pixels, its camera 48x36"), "{error}");
}

fn short() -> TrainSettings {
    TrainSettings { pose_opt: true, pose_lr: 1e-3, ..checkpoints::settings() }
}

fn run(settings: TrainSettings) -> Run<'static> {
    Run::shared(crate::common::training::views(5, 40), settings)
}

/// Poses, moments and cameras go through a file, also where a densification (15) or a reset (20) is due.
#[test]
fn poses_are_resumed_to_the_bit() {
    for settings in [short(), TrainSettings { optimizer_type: OptimizerType::SparseAdam, ..short() }] {
        let run = run(settings);
        let end = run.check_stops(&[&[0], &[15], &[20], &[33]]);
        let poses = end.poses.as_ref().expect("poses");
        assert!(poses.parameters.iter().all(|xi| xi.iter().all(|&x| x != 0.0)), "{poses:?}");
        for stop in [0, 15, 20, 33, 40] {
            let mut trainer = run.begin();
            trainer.steps(stop);
            let (cameras, state) = (trainer.cameras().expect("cameras"), trainer.state());
            assert_eq!(run.resume(&state).cameras().expect("cameras"), cameras);
        }
    }
}

/// A checkpoint with poses cannot start a run without them, or vice versa. One that lost its poses is invalid.
#[test]
fn poses_of_a_checkpoint_must_fit() {
    let run = run(short());
    let sound = run.until(1, &[]);
    let refuse = |run: &Run, checkpoint: &Checkpoint, word: &str| {
        assert_says(refusal(run.try_resume(checkpoint)), &[word]);
    };
    let without = self::run(TrainSettings { pose_opt: false, ..short() });
    refuse(&without, &sound, "pose_opt was true, is false");
    refuse(&run, &Checkpoint { poses: None, ..sound.clone() }, "lacks the poses");
    let [mut fewer_poses, mut fewer_depths] = [sound.clone(), sound];
    fewer_poses.poses.as_mut().expect("poses").parameters.pop();
    fewer_depths.poses.as_mut().expect("poses").depths.pop();
    for short_one in [fewer_poses, fewer_depths] {
        refuse(&run, &short_one, "another number than the views");
    }
}

#[test]
fn poses_stay_unless_asked_for() {
    let without = run(TrainSettings { pose_opt: false, ..short() });
    let mut plain = without.begin();
    // With the option and a rate of 0, the scene trains to the same bits: the moved camera is the given one.
    let mut still = run(TrainSettings { pose_opt: true, pose_lr: 0.0, ..short() }).begin();
    // The optimiser reads the camera's position from another place, where it is rounded once more.
    assert_eq!(plain.steps(1)[0].loss.to_bits(), still.steps(1)[0].loss.to_bits());
    still.finish();
    let given: Vec<Camera> = without.views.iter().map(|view| view.camera).collect();
    for trainer in [&plain, &still] {
        assert_eq!(trainer.cameras().expect("cameras"), given);
    }
    assert!(plain.state().poses.is_none());
}
