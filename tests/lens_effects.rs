//! Training that learns the cameras' vignetting and response.

use ashsplat::scene::{LensEffects, Photo};
use ashsplat::trainer::{Checkpoint, Trainer};
use ashsplat::{TrainSettings, TrainView};
use ashsplat_files::{CheckpointFile, metrics};

use crate::checkpoints::{check_memory_of, settings as small_settings, start, views};
use crate::common::gpu::Gpu;
use crate::exposures::{EXTENT, cameras, gray, photographs};

/// Every other photograph is from the second camera, which darkens corners, mostly in blue, and has another
/// response.
fn camera_of(view: usize) -> u32 {
    if view.is_multiple_of(2) { 7 } else { 9 }
}

const KNOWN: LensEffects = LensEffects {
    rows: [[-0.30, -0.10, -0.05, 0.14], [-0.30, -0.10, -0.05, 0.10], [-0.36, -0.16, -0.04, 0.06]],
};
/// One view of each camera.
const HELD_OUT: [usize; 2] = [4, 7];

fn taken(shown: &[Photo]) -> Vec<Photo> {
    let of = |(view, photo): (usize, &Photo)| {
        let mut pixels = photo.to_f32();
        if camera_of(view) == 9 {
            KNOWN.apply(&cameras()[view], &mut pixels);
        }
        Photo::from_f32(photo.width, photo.height, &pixels).expect("a photograph")
    };
    shown.iter().enumerate().map(of).collect()
}

fn settings(lens_effects: bool) -> TrainSettings {
    TrainSettings {
        iterations: 1200,
        sh_degree: 0,
        feature_lr: 0.02,
        opacity_lr: 0.05,
        densify_until_iter: 0,
        opacity_reset_interval: 100_000,
        lens_effects,
        seed: 2,
        ..TrainSettings::default()
    }
}

/// Returns the mean PSNR of the held-out views against their photographs, and the effects of both cameras.
fn train(gpu: &Gpu, taken: &[Photo], lens_effects: bool) -> (f64, Vec<LensEffects>) {
    let all: Vec<usize> = (0..taken.len()).filter(|view| !HELD_OUT.contains(view)).collect();
    let views = all
        .iter()
        .map(|&view| TrainView::new(cameras()[view], taken[view].clone()).taken_by(camera_of(view)));
    let settings = settings(lens_effects);
    let mut trainer =
        Trainer::new(gpu.context, views.collect(), &gray(1), EXTENT, settings).expect("a trainer");
    let steps = trainer.settings().iterations;
    (0..steps).for_each(|_| assert!(trainer.step().expect("a step").loss.is_finite()));
    let of_views = trainer.lens_effects().expect("effects");
    let effects: Vec<LensEffects> = [7, 9]
        .iter()
        .filter_map(|&camera| {
            let view = all.iter().position(|&view| camera_of(view) == camera).expect("a view");
            of_views.get(view).copied()
        })
        .collect();
    let render = trainer.render_settings();
    let quality = HELD_OUT.map(|view| {
        let camera = cameras()[view];
        let mut frame = trainer.render(&camera, &render).expect("a frame");
        if let Some(effects) = effects.get(view % 2) {
            effects.apply(&camera, &mut frame.color);
        }
        metrics::psnr(&frame.color, &taken[view].to_f32()).expect("a number")
    });
    (quality.iter().sum::<f64>() / quality.len() as f64, effects)
}

/// Converts a colour of the first camera to the second.
fn from_first_to_second([first, second]: [&LensEffects; 2], color: f32, channel: usize, r2: f32) -> f32 {
    let behind = color.powf(first.response()[channel].recip());
    let scene = behind / first.vignetting(channel, r2);
    second.of([scene; 3], r2)[channel]
}

/// Photographs of two cameras, one of which darkens corners and has another response. Training learns their
/// difference, and held-out views come closer to their photographs.
#[test]
fn lens_effects_are_recovered() {
    let gpu = Gpu::unchecked();
    let taken = taken(&photographs(&gpu));
    let (ignored, none) = train(&gpu, &taken, false);
    assert!(none.is_empty());
    let (learnt, effects) = train(&gpu, &taken, true);
    let mut worst: f32 = 0.0;
    for (channel, r2) in (0..3).flat_map(|channel| (0..=9).map(move |k| (channel, k as f32 / 10.0))) {
        for color in [0.25, 0.5, 0.75] {
            let expected = from_first_to_second([&LensEffects::default(), &KNOWN], color, channel, r2);
            let found = from_first_to_second([&effects[0], &effects[1]], color, channel, r2);
            worst = worst.max((found / expected - 1.0).abs());
        }
    }
    println!("held out: ignored {ignored:.2} dB, learnt {learnt:.2} dB; off by {worst:.4}; {effects:?}");
    assert!(worst < 0.04, "off by {worst}");
    assert!(learnt > ignored + 2.0, "{ignored} dB, with lens effects {learnt} dB");
}

#[test]
fn lens_effects_resume_to_the_bit() {
    let gpu = Gpu::new();
    for exposure in [false, true] {
        let settings = TrainSettings { lens_effects: true, exposure, lens_lr: 0.02, ..small_settings() };
        let all = || {
            let mut all = views(4, 40);
            all[1].camera_id = 12;
            all[2].camera_id = 5;
            all[3].camera_id = 12;
            all
        };
        let new = || Trainer::new(gpu.context, all(), &start(), EXTENT, settings.clone()).expect("a trainer");
        let mut whole = new();
        (0..40).for_each(|_| drop(whole.step().expect("a step")));
        let end = whole.checkpoint().expect("the end");
        assert_eq!(end.lenses.values.len(), 3);
        assert!(end.lenses.values.iter().all(|rows| rows.as_flattened().iter().all(|&x| x != 0.0)));
        let effects = whole.lens_effects().expect("effects");
        assert!(effects.len() == 4 && effects[1] == effects[3] && effects[0] != effects[2]);
        for stop in [1, 15, 27] {
            let mut trainer = new();
            (0..stop).for_each(|_| drop(trainer.step().expect("a step")));
            let folder = tempfile::tempdir().expect("a temporary folder");
            let path = folder.path().join("a.safetensors");
            trainer.checkpoint().expect("a checkpoint").write(&path).expect("written");
            let read = Checkpoint::read(&path).expect("read back");
            let resumed = Trainer::resume(gpu.context, all(), EXTENT, settings.clone(), &read);
            let mut trainer = resumed.expect("resumed");
            (stop..40).for_each(|_| drop(trainer.step().expect("a step")));
            assert!(trainer.checkpoint().expect("the end") == end, "interrupted after {stop}: other bits");
        }
        let refused = |from: &Checkpoint, views: Vec<TrainView>| {
            let refused = Trainer::resume(gpu.context, views, EXTENT, settings.clone(), from);
            refused.err().expect("refused").to_string()
        };
        let mut lacks = end.clone();
        lacks.iteration -= 1;
        // Views of other cameras.
        let message = refused(&lacks, views(4, 40));
        assert!(message.contains("other photographs or cameras"), "{message}");
        lacks.lenses.first_moments.pop();
        let message = refused(&lacks, all());
        assert!(message.contains("lenses"), "{message}");
    }
}

/// Without the option, the camera of a photograph does not matter.
#[test]
fn lens_effects_stay_none_unless_asked_for() {
    let gpu = Gpu::new();
    let run = |camera_id: u32| {
        let views = views(3, 40).into_iter().map(|view| view.taken_by(camera_id)).collect();
        let mut trainer =
            Trainer::new(gpu.context, views, &start(), EXTENT, small_settings()).expect("a trainer");
        (0..20).for_each(|_| drop(trainer.step().expect("a step")));
        assert!(trainer.lens_effects().expect("none").is_empty());
        trainer.checkpoint().expect("a state")
    };
    assert!(run(0) == run(3));
}

/// The memory for lens effects is forecast and counted.
#[test]
fn lens_effects_are_within_the_memory() {
    let without = TrainSettings { iterations: 3, ..small_settings() };
    check_memory_of(&TrainSettings { lens_effects: true, ..without.clone() }, &without);
}
