//! Pictures of several shapes: wide and high ones share the memory of one, and large ones do not affect later ones.

use ashsplat::scene::{Camera, Intrinsics};
use ashsplat::trainer::{Checkpoint, Forecast, PhotoSize, Room, TrainView, Trainer};
use ashsplat::vk::{Context, ContextOptions, LimitsOverride};
use ashsplat::{Error, RenderSettings, Renderer, TrainSettings};
use ashsplat_files::{CheckpointFile, Photo};
use glam::Vec3;
use tempfile::tempdir;

use crate::checkpoints::start;
use crate::common::device::assert_uses_all;
use crate::common::engine::{camera, renderer};
use crate::common::gpu::Gpu;
use crate::common::scenes::small_view;
use crate::common::{assert_silent, bounded, options};

const WIDE: [u32; 2] = [320, 32];
const HIGH: [u32; 2] = [32, 320];
/// More bytes than a picture of either shape needs in one buffer, fewer than one that is both wide and high.
const RANGE: u64 = 500_000;
const EXTENT: f32 = 5.0;

fn settings() -> TrainSettings {
    TrainSettings {
        iterations: 30,
        sh_degree: 1,
        densify_from_iter: 2,
        densification_interval: 5,
        densify_until_iter: 12,
        densify_grad_threshold: 1e-6,
        ..TrainSettings::default()
    }
}

fn view_of(size: [u32; 2]) -> TrainView {
    let [width, height] = size;
    let rgb = (0..width * height * 3).map(|k| (k * 7) as u8).collect();
    TrainView::new(camera(&small_view(size)), Photo { width, height, rgb })
}

fn views_of(sizes: &[[u32; 2]]) -> Vec<TrainView> {
    sizes.iter().map(|&size| view_of(size)).collect()
}

fn narrow_context() -> Context {
    let limits = LimitsOverride { max_storage_buffer_range: Some(RANGE), ..LimitsOverride::default() };
    Context::new(&ContextOptions { limits_override: Some(limits), ..options() }).expect("a device")
}

fn peak_of(context: &Context, arena: &str) -> u64 {
    let all = context.memory();
    all.iter().find(|memory| memory.name == arena).map_or(0, |memory| memory.peak_bytes)
}

/// Bytes of the frame and of the loss during four iterations.
fn reserved(sizes: &[[u32; 2]]) -> [u64; 2] {
    let context = narrow_context();
    let still = TrainSettings { densify_from_iter: 100, ..settings() };
    let mut trainer = Trainer::new(&context, views_of(sizes), &start(), EXTENT, still).expect("a trainer");
    let used = |context: &Context| ["frame", "loss"].map(|arena| peak_of(context, arena));
    trainer.step().expect("a step");
    let first = used(&context);
    (0..4).for_each(|_| drop(trainer.step().expect("a step")));
    assert_eq!(used(&context), first, "all of it is there from the first iteration on");
    drop(trainer);
    assert_silent(&context);
    first
}

#[test]
fn orientations_train_together_in_the_memory_of_one() {
    let (wide, high) = (reserved(&[WIDE; 3]), reserved(&[HIGH; 3]));
    let both = reserved(&[WIDE, HIGH, WIDE]);
    assert_eq!(both, [0, 1].map(|arena| wide[arena].max(high[arena])), "{wide:?} {high:?}");
}

/// Pictures and gradients do not depend on earlier frames.
#[test]
fn orientations_of_earlier_frames_change_no_bit() {
    let cameras = [WIDE, HIGH, [150, 70]].map(|size| camera(&small_view(size)));
    let settings = RenderSettings { inverse_depth: true, ..RenderSettings::default() };
    let draw = |renderer: &mut Renderer, camera: &Camera| {
        let frame = renderer.render(camera, &settings).expect("a frame");
        let gradient: Vec<_> = frame.color.iter().map(|c| c.map(|c| c - 0.4)).collect();
        let ones = vec![0.25; gradient.len()];
        let derived = renderer.gradients(camera, &settings, &gradient, Some(&ones)).expect("gradients");
        (frame.color, frame.transmittance, frame.inverse_depth, derived)
    };
    let mut used = renderer();
    used.upload(&start()).expect("uploaded");
    let alone = cameras.map(|camera| {
        used.shrink();
        draw(&mut used, &camera)
    });
    for turn in 0..2 {
        for (camera, alone) in cameras.iter().zip(&alone) {
            let [width, height] = [camera.width, camera.height];
            assert!(draw(&mut used, camera) == *alone, "{width}x{height}, turn {turn}");
        }
    }
}

/// An error names a photo that is too large, with its own size and bytes, whatever the others are, and before any is
/// read.
#[test]
fn orientations_that_do_not_fit_are_named_with_their_own_bytes() {
    let context = narrow_context();
    let (width, height) = (320, 128);
    let photo = |name: &str, [width, height]: [u32; 2]| PhotoSize {
        name: name.into(),
        width,
        height,
        masked: false,
        inverse_depth: false,
        depth_points: 0,
    };
    let photos = [photo("a.jpg", WIDE), photo("sky/b.jpg", [width, height]), photo("c.jpg", HIGH)];
    let settings = settings();
    let check = |photos: &[PhotoSize]| {
        let (photo_memory, room) = (None, None);
        Forecast { settings: &settings, photos, photo_memory, gaussians: 150, frozen: 0, room }
            .check(&context)
    };
    let said = |error: &Error| {
        let Error::TooLarge { needed, limit: RANGE, .. } = error else { panic!("{error}") };
        (*needed, error.to_string())
    };
    let (needed, message) = said(&check(&photos).expect_err("too large"));
    assert_eq!(needed, u64::from(width * height) * 16, "{message}");
    for word in ["'sky/b.jpg' of 320x128 pixels (", "-r ", "655360 bytes", "maxStorageBufferRange"] {
        assert!(message.contains(word), "no '{word}' in {message}");
    }
    // The largest of several. The trainer gives the same error without names.
    let twice = [&photos[..], &[photo("d.jpg", [136, 320])]].concat();
    let (_, message) = said(&check(&twice).expect_err("too large"));
    assert!(message.contains("'d.jpg' of 136x320 pixels and 1 other"), "{message}");
    let views = views_of(&[WIDE, [width, height], HIGH]);
    let refused = Trainer::new(&context, views, &start(), EXTENT, settings.clone()).err().expect("refused");
    assert!(said(&refused).1.contains("'view 1' of 320x128 pixels ("), "{refused}");
    assert_eq!(context.memory_total().peak_bytes, 0, "nothing was allocated");
    // The photos that fit are trained on.
    check(&[photos[0].clone(), photos[2].clone()]).expect("both fit");
    assert_silent(&context);
}

/// Training takes exactly the memory that the forecast says.
#[test]
fn orientations_need_the_memory_that_is_forecast() {
    let sizes = [WIDE, HIGH, WIDE];
    let settings = settings();
    let photo = |(index, &[width, height]): (usize, &[u32; 2])| PhotoSize {
        name: format!("{index}.jpg"),
        width,
        height,
        masked: false,
        inverse_depth: false,
        depth_points: 0,
    };
    let photos: Vec<_> = sizes.iter().enumerate().map(photo).collect();
    let check = |context: &Context| {
        let (photo_memory, room) = (None, None);
        Forecast { settings: &settings, photos: &photos, photo_memory, gaussians: 150, frozen: 0, room }
            .check(context)
    };
    let refused = check(&bounded(Some(100_000))).expect_err("too little");
    let Error::TooLarge { needed, limit: 100_000, .. } = refused else { panic!("{refused}") };
    for word in ["3 photographs", "of 320x32 pixels", "-r"] {
        assert!(refused.to_string().contains(word), "no '{word}' in {refused}");
    }
    let context = bounded(Some(needed));
    check(&context).expect("as much as was asked for");
    let trainer = Trainer::new(&context, views_of(&sizes), &start(), EXTENT, settings.clone());
    trainer.expect("a trainer").step().expect("a step");
    assert_uses_all(&context, needed);
    drop(context);
    assert!(check(&bounded(Some(needed - 1))).is_err());
}

/// Earlier versions stored the largest width and the largest height, and had a capacity for their product.
#[test]
fn orientations_go_on_from_checkpoints_of_earlier_versions() {
    let gpu = Gpu::new();
    let views = || views_of(&[WIDE, HIGH, WIDE]);
    let mut trainer = Trainer::new(gpu.context, views(), &start(), EXTENT, settings()).expect("a trainer");
    (0..8).for_each(|_| drop(trainer.step().expect("a step")));
    let folder = tempdir().expect("a folder");
    let path = folder.path().join("a.safetensors");
    let checkpoint = trainer.checkpoint().expect("a checkpoint");
    checkpoint.write(&path).expect("written");
    let read = Checkpoint::read(&path).expect("read");
    // Stored in this form, because older programs need it.
    assert_eq!((read.room.frame_width, read.room.frame_height), (320, 320));
    while trainer.iteration() < settings().iterations {
        trainer.step().expect("a step");
    }
    let end = trainer.checkpoint().expect("the end");
    for (frame_width, frame_height) in [(320, 320), (320, 32), (4000, 4000)] {
        // The product does not fit this device.
        let context = narrow_context();
        let from = Checkpoint { room: Room { frame_width, frame_height, ..read.room }, ..read.clone() };
        let resumed = Trainer::resume(&context, views(), EXTENT, settings(), &from);
        let mut resumed = resumed.expect("resumed");
        assert_eq!(resumed.checkpoint().expect("a checkpoint").room, read.room);
        while resumed.iteration() < settings().iterations {
            resumed.step().expect("a step");
        }
        let there = resumed.checkpoint().expect("the end");
        assert!(there.fingerprint() == end.fingerprint(), "{frame_width}x{frame_height}: other bits");
        drop(resumed);
        assert_silent(&context);
    }
}

fn odd_camera(width: u32, height: u32) -> Camera {
    let lens = Intrinsics::from_fov_x(0.8, width, height);
    Camera::look_at(Vec3::NEG_Z * 4.0, Vec3::ZERO, Vec3::NEG_Y, lens)
}

/// A line of 65,535 pixels, followed by pictures of usual sizes.
#[test]
fn orientations_that_are_odd_spoil_no_later_frame() {
    let limits = LimitsOverride { max_storage_buffer_range: Some(8 << 20), ..LimitsOverride::default() };
    let context =
        Context::new(&ContextOptions { limits_override: Some(limits), ..options() }).expect("a device");
    let mut renderer = Renderer::new(&context).expect("a renderer");
    renderer.upload(&start()).expect("uploaded");
    let settings = RenderSettings::default();
    let usual = renderer.render(&odd_camera(320, 180), &settings).expect("a frame");
    let bytes = renderer.frame_bytes();
    for (width, height) in [(65_535, 1), (1, 65_535)] {
        renderer.render(&odd_camera(width, height), &settings).expect("a line");
        let again = renderer.render(&odd_camera(320, 180), &settings).expect("a frame");
        assert!(again.color == usual.color, "after {width}x{height}");
    }
    // Capacity for the line's tiles and pixels, and no more.
    let (grown, tiles) = (renderer.frame_bytes(), 4096);
    assert!(grown > bytes && grown < bytes + 65_535 * 24 + tiles * 1024, "{bytes}, then {grown}");
    renderer.shrink();
    assert_eq!(renderer.frame_bytes(), 0);
    let again = renderer.render(&odd_camera(320, 180), &settings).expect("a frame");
    assert!(again.color == usual.color && renderer.frame_bytes() == bytes, "as at first");
    drop(renderer);
    assert_silent(&context);
}

/// If a frame does not fit beside the buffers of earlier ones, those are freed.
#[test]
fn orientations_of_earlier_frames_are_given_up_for_want_of_memory() {
    let settings = RenderSettings::default();
    let (large, small) = (odd_camera(1024, 768), odd_camera(96, 64));
    let image_gradient = vec![[0.5; 3]; 96 * 64];
    let fresh = |max_memory: Option<u64>| {
        let context = Context::new(&ContextOptions { max_memory, ..options() }).expect("a device");
        let mut renderer = Renderer::new(&context).expect("a renderer");
        renderer.upload(&start()).expect("uploaded");
        renderer
    };
    let peak = |renderer: &Renderer| renderer.context().memory_total().peak_bytes;
    let mut alone = fresh(None);
    let picture = alone.render(&large, &settings).expect("a frame");
    let most = peak(&alone);
    let mut alone = fresh(None);
    let gradients = alone.gradients(&small, &settings, &image_gradient, None).expect("gradients");
    assert!(peak(&alone) < most, "less than the picture needs");
    // Buffers for sums of gradients are not freed.
    let most = most + (512 << 10);
    let mut bounded = fresh(Some(most));
    for _ in 0..2 {
        // Each is larger than the other in one way: both together do not fit.
        assert!(bounded.render(&large, &settings).expect("a frame").color == picture.color);
        let again = bounded.gradients(&small, &settings, &image_gradient, None).expect("gradients");
        assert!(again == gradients);
    }
    assert_silent(bounded.context());
}
