//! Displaced poses are recovered.

use ashsplat::poses::PoseBuffers;
use ashsplat::scene::{StoredPhoto, Twist, scene_extent};
use ashsplat::trainer::{Forecast, PhotoSize, StrategyType, TrainView, Trainer};
use ashsplat::{Alignment, Camera, Checkpoint, Error, Gaussians, RenderSettings, TrainSettings};
use ashsplat_files::{CheckpointFile, Photo, metrics};
use glam::DVec3;

use crate::checkpoints;
use crate::common::bounded;
use crate::common::engine::{camera, gaussians, renderer};
use crate::common::gpu::Gpu;
use crate::common::scenes::{Random, rotation_about_y, small_scene, small_view};
use crate::reference::types::View;

const SIZE: [u32; 2] = [96, 72];
const VIEWS: u32 = 8;

fn scene() -> Gaussians {
    gaussians(&small_scene(&mut Random::new(41), 150, 4))
}

/// Cameras around the scene.
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

fn photographs() -> Vec<StoredPhoto> {
    let mut renderer = renderer();
    renderer.upload(&scene()).expect("upload");
    let photograph = |camera: &Camera| {
        let frame = renderer.render(camera, &RenderSettings::default()).expect("a photograph");
        let byte = |x: &f32| (x * 255.0).round().clamp(0.0, 255.0) as u8;
        let rgb = frame.color.iter().flatten().map(byte).collect();
        StoredPhoto::from(Photo { width: SIZE[0], height: SIZE[1], rgb })
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
    let mut most = (0.0_f64, 0.0_f64);
    for (camera, other) in cameras.iter().zip(others) {
        let turn = camera.camera_from_world.as_dmat3() * other.camera_from_world.as_dmat3().transpose();
        let axis = DVec3::new(
            turn.y_axis.z - turn.z_axis.y,
            turn.z_axis.x - turn.x_axis.z,
            turn.x_axis.y - turn.y_axis.x,
        );
        let angle = (0.5 * axis.length()).asin().to_degrees();
        let distance = camera.exact_position().distance(other.exact_position()) / f64::from(extent());
        most = (most.0.max(angle), most.1.max(distance));
    }
    most
}

fn views(cameras: &[Camera]) -> Vec<TrainView> {
    cameras.iter().zip(photographs()).map(|(&camera, photo)| TrainView::new(camera, photo)).collect()
}

/// Settings that keep the scene unchanged.
fn fixed(iterations: u32) -> TrainSettings {
    TrainSettings {
        iterations,
        sh_degree: 1,
        sh_degree_interval: 1,
        strategy: StrategyType::Fixed,
        position_lr_init: 1e-30,
        position_lr_final: 1e-30,
        feature_lr: 0.0,
        opacity_lr: 0.0,
        scaling_lr: 0.0,
        rotation_lr: 0.0,
        pose_opt: true,
        pose_lr: 1e-2,
        ..TrainSettings::default()
    }
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
    for _ in 0..1500 {
        trainer.step().expect("a step");
    }
    let (degrees, share) = apart(&trainer.cameras().expect("cameras"), &cameras());
    // With turns about the cameras' centres, 0.015 and 2.2e-4 remain.
    println!("left of 1 degree: {degrees:.4}, of 0.01 of the extent: {share:.6}");
    assert!(degrees < 0.011 && share < 1.6e-4, "{degrees} degrees, {share} of the extent");
    assert!(trainer.gaussians().expect("Gaussians") == scene(), "the scene was to stay");
}

fn psnr(trainer: &mut Trainer, cameras: &[Camera]) -> f64 {
    let settings = trainer.render_settings();
    let each = cameras.iter().zip(photographs()).map(|(camera, photo)| {
        let frame = trainer.render(camera, &settings).expect("a frame");
        metrics::psnr(&frame.color, &photo.photo().expect("a photo").to_f32()).expect("PSNR")
    });
    each.sum::<f64>() / cameras.len() as f64
}

/// Optimises scene and poses together, both displaced. Without poses, the scene can only blur.
#[test]
fn poses_and_scene_together_are_better_than_the_scene_alone() {
    let gpu = Gpu::unchecked();
    let mut start = scene();
    let mut random = Random::new(6);
    start.means.iter_mut().flatten().for_each(|x| *x += 0.03 * random.signed() as f32);
    start.sh.iter_mut().flatten().for_each(|x| *x += 0.2 * random.signed() as f32);
    let train = |pose_opt: bool| {
        let settings = TrainSettings {
            iterations: 600,
            sh_degree: 1,
            sh_degree_interval: 1,
            strategy: StrategyType::Fixed,
            position_lr_init: 3e-4,
            position_lr_final: 3e-5,
            position_lr_max_steps: 600,
            pose_opt,
            pose_lr: 2e-3,
            ..TrainSettings::default()
        };
        let mut trainer =
            Trainer::new(gpu.context, views(&perturbed()), &start, extent(), settings).expect("a trainer");
        for _ in 0..600 {
            trainer.step().expect("a step");
        }
        let own = trainer.cameras().expect("cameras");
        (psnr(&mut trainer, &own), own)
    };
    let ((without, same), (with, moved)) = (train(false), train(true));
    assert_eq!(same, perturbed());
    let (degrees, share) = apart(&moved, &cameras());
    println!(
        "PSNR of the training views: {without:.2} dB, with poses {with:.2} dB; left: {degrees:.3} degrees, {share:.5}"
    );
    assert!(with > without + 3.0, "{without} dB, with poses {with} dB");
}

#[test]
fn poses_of_held_out_views_are_aligned() {
    let gpu = Gpu::new();
    let (cameras, given, photos) = (cameras(), perturbed(), photographs());
    let alignment = Alignment::default();
    let settings = RenderSettings::default();
    let mut trainer =
        Trainer::new(gpu.context, views(&cameras), &scene(), extent(), fixed(10)).expect("a trainer");
    trainer.step().expect("a step");
    let before = trainer.checkpoint().expect("a state");
    let mut aligned = Vec::new();
    for (camera, photo) in given.iter().zip(&photos).take(3) {
        aligned.push(trainer.align(camera, photo, &settings, &alignment).expect("aligned"));
    }
    let (degrees, share) = apart(&aligned, &cameras);
    println!("aligned to {degrees:.4} degrees, {share:.6} of the extent");
    assert!(degrees < 0.15 && share < 2e-3, "{degrees} degrees, {share} of the extent");
    assert!(trainer.checkpoint().expect("a state") == before, "training has changed");
    // A renderer gives the same result.
    let mut renderer = renderer();
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

fn new(gpu: &Gpu, settings: &TrainSettings) -> Trainer {
    Trainer::new(gpu.context, checkpoints::views(5, 40), &checkpoints::start(), 5.0, settings.clone())
        .expect("a trainer")
}

/// Poses, moments and cameras go through a file, also where a densification (15) or a reset (20) is due.
#[test]
fn poses_are_resumed_to_the_bit() {
    let gpu = Gpu::new();
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("c.safetensors");
    for settings in
        [short(), TrainSettings { optimizer_type: ashsplat::trainer::OptimizerType::SparseAdam, ..short() }]
    {
        let mut whole = new(&gpu, &settings);
        (0..40).for_each(|_| drop(whole.step().expect("a step")));
        let end = whole.checkpoint().expect("the end");
        let poses = end.poses.as_ref().expect("poses");
        assert!(poses.parameters.iter().all(|xi| xi.iter().all(|&x| x != 0.0)), "{poses:?}");
        for stop in [0, 15, 20, 33] {
            let mut trainer = new(&gpu, &settings);
            (0..stop).for_each(|_| drop(trainer.step().expect("a step")));
            trainer.checkpoint().expect("one").write(&path).expect("written");
            let cameras = trainer.cameras().expect("cameras");
            drop(trainer);
            let read = Checkpoint::read(&path).expect("read");
            let views = checkpoints::views(5, 40);
            let resumed = Trainer::resume(gpu.context, views, 5.0, settings.clone(), &read);
            let mut trainer = resumed.expect("resumed");
            assert_eq!(trainer.cameras().expect("cameras"), cameras);
            (stop..40).for_each(|_| drop(trainer.step().expect("a step")));
            assert!(trainer.checkpoint().expect("the end") == end, "interrupted after {stop}: other bits");
            assert_eq!(trainer.cameras().expect("cameras"), whole.cameras().expect("cameras"));
        }
    }
}

/// A checkpoint with poses cannot start a run without them, or vice versa. One that lost its poses is invalid.
#[test]
fn poses_of_a_checkpoint_must_fit() {
    let gpu = Gpu::new();
    let mut trainer = new(&gpu, &short());
    trainer.step().expect("a step");
    let sound = trainer.checkpoint().expect("a checkpoint");
    let refuse = |settings: TrainSettings, checkpoint: &Checkpoint, word: &str| {
        let refused = Trainer::resume(gpu.context, checkpoints::views(5, 40), 5.0, settings, checkpoint);
        let message = refused.err().expect("refused").to_string();
        assert!(message.contains(word), "no '{word}' in {message}");
    };
    refuse(TrainSettings { pose_opt: false, ..short() }, &sound, "pose_opt was true, is false");
    refuse(short(), &Checkpoint { poses: None, ..sound.clone() }, "lacks the poses");
    let mut short_one = sound.clone();
    short_one.poses.as_mut().expect("poses").parameters.pop();
    refuse(short(), &short_one, "another number than the views");
    let mut short_one = sound.clone();
    short_one.poses.as_mut().expect("poses").depths.pop();
    refuse(short(), &short_one, "another number than the views");
}

/// Older checkpoints lack the pivots: their cameras turn about their centres, and continue to.
#[test]
fn poses_of_older_checkpoints_turn_about_the_cameras() {
    let gpu = Gpu::new();
    let mut trainer = new(&gpu, &short());
    (0..9).for_each(|_| drop(trainer.step().expect("a step")));
    let present = trainer.checkpoint().expect("a checkpoint");
    let depths = &present.poses.as_ref().expect("poses").depths;
    assert!(depths.len() == 5 && depths.iter().all(|&depth| depth > 1.0), "{depths:?}");
    let mut older = present.clone();
    older.poses.as_mut().expect("poses").depths.clear();
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("c.safetensors");
    older.write(&path).expect("written");
    let bytes = std::fs::read(&path).expect("a file");
    assert!(!String::from_utf8_lossy(&bytes).contains(Checkpoint::POSE_DEPTHS));
    let read = Checkpoint::read(&path).expect("read");
    assert!(read == older);
    let next = |from: &Checkpoint| {
        let views = checkpoints::views(5, 40);
        let mut trainer = Trainer::resume(gpu.context, views, 5.0, short(), from).expect("resumed");
        trainer.step().expect("a step");
        trainer.checkpoint().expect("a checkpoint").poses.expect("poses")
    };
    let (older, present) = (next(&read), next(&present));
    assert_eq!(older.depths, [0.0; 5]);
    assert_ne!(older.parameters, present.parameters);
}

/// Without the option no pose is moved, stored or written.
#[test]
fn poses_stay_unless_asked_for() {
    let gpu = Gpu::new();
    let settings = TrainSettings { pose_opt: false, ..short() };
    let mut trainer = new(&gpu, &settings);
    trainer.step().expect("a step");
    let given: Vec<Camera> = checkpoints::views(5, 40).iter().map(|view| view.camera).collect();
    assert_eq!(trainer.cameras().expect("cameras"), given);
    assert!(trainer.checkpoint().expect("a checkpoint").poses.is_none());
    // With the option and a rate of 0, the scene trains to the same bits: the moved camera is the given one.
    let still = TrainSettings { pose_opt: true, pose_lr: 0.0, ..short() };
    let (mut plain, mut still) = (new(&gpu, &settings), new(&gpu, &still));
    for iteration in 1..=40 {
        let losses = [&mut plain, &mut still].map(|trainer| trainer.step().expect("a step").loss.to_bits());
        // The optimiser reads the camera's position from another place, where it is rounded once more.
        if iteration == 1 {
            assert_eq!(losses[0], losses[1]);
        }
    }
    assert_eq!(still.cameras().expect("cameras"), given);
}

/// The memory in an error includes the poses.
#[test]
fn poses_count_among_the_memory() {
    let needed = |pose_opt: bool, photos: usize| {
        let context = bounded(Some(1 << 20));
        let photos: Vec<PhotoSize> = (0..photos)
            .map(|i| PhotoSize {
                name: format!("{i}.png"),
                width: 300,
                height: 200,
                masked: false,
                inverse_depth: false,
                depth_points: 0,
            })
            .collect();
        let settings = TrainSettings { pose_opt, ..TrainSettings::default() };
        let forecast = Forecast {
            settings: &settings,
            photos: &photos,
            photo_memory: None,
            gaussians: 1000,
            frozen: 0,
            room: None,
        };
        match forecast.check(&context).expect_err("too much") {
            Error::TooLarge { needed, .. } => needed,
            other => panic!("{other}"),
        }
    };
    for photos in [3, 900] {
        let more = needed(true, photos) - needed(false, photos);
        let poses = PoseBuffers::requests(photos as u32);
        let bytes: u64 = poses.iter().map(|(_, bytes)| bytes).sum();
        assert!((bytes..bytes + 4096).contains(&more), "{more} bytes more for {bytes}");
        assert!(bytes >= 172 * photos as u64);
    }
}
