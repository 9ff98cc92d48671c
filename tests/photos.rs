//! Photographs in training: masked pixels have no loss, and reading photographs during training changes nothing.

use crate::common::prelude::*;
use crate::common::training;
use ashsplat::passes::loss::{NativeLayout, photo_bytes};
use ashsplat::scene::PhotoSource;
use ashsplat_files::{PhotoFileFormat, PhotoMemory, StoredPhoto};
use std::sync::Arc;

/// Memory for `held` photographs on the device and, in the same form, on the host, while two are read.
fn held_bytes(views: &[TrainView], held: u64) -> u64 {
    let layout = NativeLayout::of(Gpu::new().context.limits());
    let bytes = |photo: &StoredPhoto| photo_bytes(layout, photo.width, photo.height, photo.is_masked());
    let largest = views.iter().map(|view| bytes(&view.photo)).max().expect("views");
    held * largest + 2 * 4 * 40 * 30
}

/// The views with their photographs in a file, with memory for `held` of them.
pub fn in_a_file(views: &[TrainView], held: u64) -> Vec<TrainView> {
    let memory = PhotoMemory { bytes: held_bytes(views, held), folder: std::env::temp_dir() };
    let file = memory.create_file().expect("a file");
    let stored = |view: &TrainView| file.store(&view.photo).expect("stored");
    views.iter().map(|view| TrainView::new(view.camera, stored(view))).collect()
}

/// Settings of the checkpoint tests, but without an opacity reset and without random backgrounds.
fn short() -> TrainSettings {
    let usual = TrainSettings::reference();
    TrainSettings {
        opacity_reset_interval: usual.opacity_reset_interval,
        random_background: usual.random_background,
        ..training::settings()
    }
}

/// Ten photographs, every third with a mask.
fn views() -> Vec<TrainView> {
    let mut views = training::views(10, 9);
    for (i, view) in views.iter_mut().enumerate().filter(|(i, _)| i % 3 == 0) {
        let photo = view.photo.photo().expect("in memory");
        view.photo = masked(Photo::clone(&photo), i);
    }
    views
}

fn is_hidden(view: usize, pixel: usize) -> bool {
    (pixel / 7 + view).is_multiple_of(3)
}

fn masked(photo: Photo, view: usize) -> StoredPhoto {
    let mask = (0..40 * 30).map(|pixel| if is_hidden(view, pixel) { 0 } else { 255 }).collect();
    StoredPhoto::new(photo, Some(mask))
}

fn run(context: &Context, views: Vec<TrainView>) -> Run<'_> {
    Run::new(context, views, short())
}

fn train(context: &Context, views: Vec<TrainView>, until: u32) -> (Trainer, Vec<f32>) {
    let mut trainer = run(context, views).begin();
    let losses = trainer.losses(until);
    (trainer, losses)
}

#[test]
fn photos_from_a_file_give_the_same_bits() {
    // A separate device, because other tests' photographs would be counted.
    let context = Context::new(&options()).expect("a device");
    let views = views();
    let (trainer, expected_losses) = train(&context, views.clone(), 26);
    let expected = trainer.trained();
    let of_photos = |trainer: &Trainer| {
        trainer.memory().iter().find(|arena| arena.name == "photos").map(|arena| arena.bytes)
    };
    let resident = of_photos(&trainer);
    drop(trainer);
    for held in [5, 14] {
        let (trainer, streamed) = train(&context, in_a_file(&views, held), 26);
        assert_eq!(streamed, expected_losses, "{held} held");
        assert!(trainer.trained() == expected, "{held} held");
        assert!(held == 14 || of_photos(&trainer) < resident);
    }
    // A checkpoint does not depend on where the photographs were.
    let checkpoint = run(&context, views.clone()).until(17, &[]);
    let mut resumed = run(&context, in_a_file(&views, 6)).resume(&checkpoint);
    assert!(resumed.losses(9) == expected_losses[17..] && resumed.trained() == expected);
    // A data set with another mask is a different one.
    let mut others = views;
    others[0].photo = StoredPhoto::from(Photo::clone(&others[0].photo.photo().expect("in memory")));
    assert_says(refusal(run(&context, others).try_resume(&checkpoint)), &["other photographs"]);
}

#[test]
fn photos_without_memory_to_read_ahead_are_refused() {
    let expected = match NativeLayout::of(context().limits()) {
        NativeLayout::Rows => "28800 bytes, more than 24000 (--photo-memory,",
        // Four planes of four strips, and the pixels of the photographs being read.
        NativeLayout::Strips => "31104 bytes, more than 25728 (--photo-memory,",
    };
    assert_says(refusal(run(context(), in_a_file(&views(), 3)).try_begin()), &[expected]);
}

/// A source gives the same training as pixels in memory. One that changes is noticed.
#[test]
fn photos_that_are_read_again_are_what_they_were() {
    #[derive(Debug)]
    struct Source(std::path::PathBuf);
    impl PhotoSource for Source {
        fn path(&self) -> &std::path::Path {
            &self.0
        }
        fn read(&self) -> ashsplat::Result<Photo> {
            Photo::read(&self.0, [0.0; 3])
        }
    }
    let folder = tempfile::tempdir().expect("a folder");
    let (views, masked) = (training::views(10, 9), views().swap_remove(0));
    let memory = PhotoMemory { bytes: held_bytes(&views, 5), folder: folder.path().to_owned() };
    let file = memory.create_file().expect("a file");
    let path = |index: usize| folder.path().join(format!("{index}.png"));
    let again = |(index, view): (usize, &TrainView)| {
        view.photo.photo().expect("in memory").write_png(path(index)).expect("written");
        let photo = file.leave(&view.photo, Arc::new(Source(path(index)))).expect("no mask");
        TrainView::new(view.camera, photo)
    };
    let left: Vec<TrainView> = views.iter().enumerate().map(again).collect();
    let source = || Arc::new(Source(path(0)));
    let refused = |result: ashsplat::Result<()>, words: &str| {
        assert_says(result.expect_err("refused").to_string(), &[words]);
    };
    refused(file.leave(&masked.photo, source()).map(drop), "has a mask: store it in the file");
    assert_eq!(left[3].photo.texels().expect("read"), views[3].photo.texels().expect("in memory"));
    let (expected, losses) = train(context(), views, 26);
    let (trainer, read) = train(context(), left.clone(), 26);
    assert!(read == losses && trainer.trained() == expected.trained());
    std::fs::copy(path(1), path(0)).expect("another photograph");
    refused(left[0].photo.photo().map(drop), "0.png: has changed since the training began");
    std::fs::remove_file(path(0)).expect("removed");
    refused(left[0].photo.photo().map(drop), "0.png: can no longer be read");
}

#[test]
fn photos_and_masks_of_wrong_sizes_are_refused() {
    let refused = |photo: StoredPhoto, said: &str| {
        let view = TrainView::new(training::views(1, 3)[0].camera, photo);
        assert_says(refusal(run(context(), vec![view]).try_begin()), &[said]);
    };
    let photo = |bytes: usize| Photo { width: 40, height: 30, rgb: vec![5; bytes] };
    refused(photo(77).into(), "has 77 bytes, not three per pixel");
    let masked = StoredPhoto::new(photo(3600), Some(vec![255; 3]));
    refused(masked, "the mask has 3 bytes, not one per pixel");
}

/// Views of several sizes, one wider and one higher than all others, some with masks. Training in strips (on CPUs)
/// equals training by pixels, up to rounding.
#[test]
fn training_in_strips_is_training_by_pixels() {
    let views: Vec<TrainView> = [[40, 30], [17, 45], [51, 9], [33, 23]]
        .into_iter()
        .enumerate()
        .map(|(i, [width, height])| {
            let turned =
                View { camera_from_world: rotation_about_y(0.2 * i as f64), ..small_view([width, height]) };
            let pixels = width * height;
            let rgb = (0..3 * pixels).map(|k| (k * (i as u32 + 3) / 5 % 256) as u8).collect();
            let mask = (i % 2 == 1).then(|| (0..pixels).map(|k| (k % 11 != 0).into()).collect());
            let photo = StoredPhoto::new(Photo { width, height, rgb }, mask);
            TrainView::new(camera(&turned), photo)
        })
        .collect();
    let [strips, pixels] =
        [Gpu::new(), Gpu::without_texels()].map(|gpu| train(gpu.context, views.clone(), 9).1);
    for (i, (a, b)) in strips.iter().zip(&pixels).enumerate() {
        assert!((a - b).abs() <= 2e-5 * b, "iteration {}: {a} in strips, {b} by pixels", i + 1);
    }
}

/// If neither a photograph nor the scene covers a pixel, both show the drawn background: only rounding remains in
/// the loss.
#[test]
fn transparent_photographs_have_the_random_background() {
    let mut out_of_view = training::start();
    out_of_view.means.iter_mut().for_each(|mean| mean[1] += 1e5);
    let kinds: [(fn() -> Gpu, bool); 3] = [(Gpu::new, false), (Gpu::new, true), (Gpu::without_texels, true)];
    for (gpu, white_background) in kinds {
        let gpu = gpu();
        let views: Vec<TrainView> = (training::views(3, 9).into_iter().enumerate())
            .map(|(i, view)| {
                let rgb = vec![255 * u8::from(white_background); 40 * 30 * 3];
                let mask = (i == 1).then(|| (0..40 * 30).map(|k| (k % 7 != 0).into()).collect());
                let photo = Photo { width: 40, height: 30, rgb };
                TrainView::new(view.camera, StoredPhoto::with_opacity(photo, &[0; 40 * 30], mask))
            })
            .collect();
        for views in [in_a_file(&views, 8), views] {
            let settings = TrainSettings { white_background, random_background: true, ..short() };
            let run = Run::new(gpu.context, views, settings).starting_at(&out_of_view);
            for report in run.begin().steps(6) {
                assert!(report.visible == 0 && report.loss < 0.004, "white {white_background}: {report:?}");
            }
        }
    }
}

/// Pixels that a mask hides have no effect on a training.
#[test]
fn photographs_under_their_masks_change_no_bit() {
    let gpu = Gpu::new();
    let mut covered = views();
    for (i, view) in covered.iter_mut().enumerate().filter(|(i, _)| i % 3 == 0) {
        let mut photo = Photo::clone(&view.photo.photo().expect("in memory"));
        for pixel in (0..40 * 30).filter(|&pixel| is_hidden(i, pixel)) {
            photo.rgb[3 * pixel..3 * pixel + 3].copy_from_slice(&[250, 30, 220]);
        }
        view.photo = masked(photo, i);
    }
    let [clean, covered] = [views(), covered].map(|views| train(gpu.context, views, 12).0.trained());
    assert!(covered == clean);
}
