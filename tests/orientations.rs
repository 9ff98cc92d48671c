//! Pictures of several shapes: wide and high ones share the memory of one, and large ones do not affect later ones.

use crate::common::device::assert_uses_all;
use crate::common::prelude::*;
use crate::common::training::{forecast_of, photo_size};
use ashsplat::scene::Intrinsics;
use ashsplat::train::PhotoSize;

const WIDE: [u32; 2] = [320, 32];
const HIGH: [u32; 2] = [32, 320];
/// More bytes than a picture of either shape needs in one buffer, fewer than one as wide and as high as both.
const RANGE: u64 = 500_000;

fn settings() -> TrainSettings {
    TrainSettings {
        iterations: 30,
        sh_degree: 1,
        densify_from_iter: 2,
        densification_interval: 5,
        densify_until_iter: 12,
        densify_grad_threshold: 1e-6,
        ..TrainSettings::reference()
    }
}

fn views_of(sizes: &[[u32; 2]]) -> Vec<TrainView> {
    sizes.iter().map(|&size| view_of(size)).collect()
}

/// Bytes of the frame and of the loss during four iterations.
fn reserved(sizes: &[[u32; 2]]) -> [u64; 2] {
    let context = with_range(RANGE);
    let still = TrainSettings { densify_from_iter: 100, ..settings() };
    let mut trainer = Run::new(&context, views_of(sizes), still).begin();
    let used = || ["frame", "loss"].map(|arena| arena_peak(&context, arena));
    trainer.steps(1);
    let first = used();
    trainer.steps(4);
    assert_eq!(used(), first, "all of it is there from the first iteration on");
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
    let context = with_range(RANGE);
    let (width, height) = (320, 128);
    let photos =
        [photo_size("a.jpg", WIDE), photo_size("sky/b.jpg", [width, height]), photo_size("c.jpg", HIGH)];
    let settings = settings();
    let check = |photos: &[PhotoSize]| forecast_of(&settings, photos, [150, 0]).check(&context);
    let said = |error: &Error| {
        let Error::TooLarge { needed, limit: RANGE, .. } = error else { panic!("{error}") };
        (*needed, error.to_string())
    };
    let (needed, message) = said(&check(&photos).expect_err("too large"));
    assert_eq!(needed, u64::from(width * height) * 16, "{message}");
    let words = ["'sky/b.jpg' of 320x128 pixels (", "-r ", "655360 bytes", "maxStorageBufferRange"];
    assert_says(&message, &words);
    // The error names the largest of several. The trainer gives the same error without file names.
    let twice = [&photos[..], &[photo_size("d.jpg", [136, 320])]].concat();
    let (_, message) = said(&check(&twice).expect_err("too large"));
    assert_says(&message, &["'d.jpg' of 136x320 pixels and 1 other"]);
    let run = Run::new(&context, views_of(&[WIDE, [width, height], HIGH]), settings.clone());
    assert_says(&said(&run.try_begin().err().expect("refused")).1, &["'view 1' of 320x128 pixels ("]);
    assert_eq!(context.memory_total().peak_bytes, 0, "nothing was allocated");
    // The photos that fit are trained on.
    check(&[photos[0].clone(), photos[2].clone()]).expect("both fit");
    assert_silent(&context);
}

#[test]
fn orientations_need_the_memory_that_is_forecast() {
    let sizes = [WIDE, HIGH, WIDE];
    let settings = settings();
    let photo = |(index, &size)| photo_size(&format!("{index}.jpg"), size);
    let photos: Vec<_> = sizes.iter().enumerate().map(photo).collect();
    let check = |context: &Context| forecast_of(&settings, &photos, [150, 0]).check(context);
    let refused = check(&bounded(Some(100_000))).expect_err("too little");
    let Error::TooLarge { needed, limit: 100_000, .. } = refused else { panic!("{refused}") };
    assert_says(refused.to_string(), &["3 photographs", "of 320x32 pixels", "-r"]);
    let context = bounded(Some(needed));
    check(&context).expect("as much as was asked for");
    Run::new(&context, views_of(&sizes), settings.clone()).begin().steps(1);
    assert_uses_all(&context, needed);
    drop(context);
    assert!(check(&bounded(Some(needed - 1))).is_err());
}

fn odd_camera(width: u32, height: u32) -> Camera {
    let lens = Intrinsics::from_fov_x(0.8, width, height);
    Camera::look_at(Vec3::NEG_Z * 4.0, Vec3::ZERO, Vec3::NEG_Y, lens)
}

/// A line of 65,535 pixels, followed by pictures of usual sizes.
#[test]
fn orientations_that_are_odd_spoil_no_later_frame() {
    let context = with_range(8 << 20);
    let mut renderer = loaded(&context, &start());
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
        loaded(&context, &start())
    };
    let peak = |renderer: &Renderer| renderer.context().memory_total().peak_bytes;
    let mut alone = fresh(None);
    let picture = alone.render(&large, &settings).expect("a frame");
    let limit = peak(&alone);
    let mut alone = fresh(None);
    let gradients = alone.gradients(&small, &settings, &image_gradient, None).expect("gradients");
    assert!(peak(&alone) < limit, "less than the picture needs");
    // Buffers for sums of gradients are not freed.
    let limit = limit + (512 << 10);
    let mut bounded = fresh(Some(limit));
    for _ in 0..2 {
        // Each is larger than the other in one way: both together do not fit.
        assert!(bounded.render(&large, &settings).expect("a frame").color == picture.color);
        let again = bounded.gradients(&small, &settings, &image_gradient, None).expect("gradients");
        assert!(again == gradients);
    }
    assert_silent(bounded.context());
}
