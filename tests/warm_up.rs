//! Runs that start with small pictures.

use crate::common::prelude::*;
use crate::common::training::{settings as small_settings, without_rates};
use ashsplat_files::StoredPhoto;

const ITERATIONS: u32 = 24;
const SIZE: [u32; 2] = [267, 259];
const PIXELS: usize = (SIZE[0] * SIZE[1]) as usize;

/// A quarter of the size for 6 iterations, half for 6.
fn settings() -> TrainSettings {
    TrainSettings { warm_up: 12, iterations: ITERATIONS, ..small_settings() }
}

/// Three views; the second has a mask.
fn large() -> Vec<TrainView> {
    let [width, height] = SIZE;
    let view = |index: u32| {
        let turned = View { camera_from_world: rotation_about_y(f64::from(index)), ..small_view(SIZE) };
        let rgb = (0..width * height * 3).map(|k| (k / 400 * (index + 3)) as u8).collect();
        let mask = (index == 1).then(|| (0..width * height).map(|k| 255 * u8::from(k % 7 > 0)).collect());
        TrainView::new(camera(&turned), StoredPhoto::new(Photo { width, height, rgb }, mask))
    };
    (0..3).map(view).collect()
}

fn run(settings: TrainSettings) -> Run<'static> {
    Run::shared(large(), settings)
}

#[test]
fn warm_up_resumes_to_the_bit() {
    let others = TrainSettings { strategy: StrategyType::Mcmc, exposure: true, ..settings() };
    let moved = TrainSettings { pose_opt: true, pose_lr: 1e-3, lens_effects: true, ..settings() };
    for settings in [settings(), others, moved] {
        let whole = run(settings.clone()).check_stops(&[&[], &[3], &[6], &[9], &[12]]);
        assert!(run(TrainSettings { warm_up: 0, ..settings }).end(&[]) != whole, "without effect");
    }
}

/// Small pictures have fewer instances, and requested pictures keep their size.
#[test]
fn warm_up_draws_fewer_tiles_at_first() {
    let mut trainer = run(TrainSettings { strategy: StrategyType::Fixed, ..settings() }).begin();
    let mut instances = |until: u32| -> u64 {
        let reports = trainer.steps(until - trainer.iteration());
        reports.iter().map(|report| u64::from(report.instances)).sum()
    };
    let [first, quarter, half, whole] = [1, 6, 12, 18].map(&mut instances);
    assert!(quarter < half && half < whole && quarter < 5 * first, "{first} {quarter} {half} {whole}");
    let picture = trainer.render(&large()[0].camera, &trainer.render_settings()).expect("a picture");
    assert_eq!(picture.color.len(), PIXELS);
}

/// The losses equal those of a training on small photographs with matching cameras.
#[test]
fn warm_up_trains_on_means_of_pixels() {
    let losses = |views: Vec<TrainView>, settings: TrainSettings| -> Vec<f32> {
        let mut trainer = Run { views, ..run(settings) }.begin();
        trainer.losses(6)
    };
    let unmasked: Vec<TrainView> = large().into_iter().step_by(2).collect();
    let small = |view: &TrainView| {
        let drawn = settings().warm_up_camera(2, &view.camera);
        let photo = view.photo.texels().expect("texels");
        let at =
            |x: usize, y: usize, channel: usize| u32::from(photo[4 * (y * SIZE[0] as usize + x) + channel]);
        let mean = |x: usize, y: usize, channel: usize| {
            let sum: u32 = (0..16).map(|k| at(4 * x + k % 4, 4 * y + k / 4, channel)).sum();
            ((sum + 8) / 16) as u8
        };
        let (width, height) = (drawn.width as usize, drawn.height as usize);
        let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        let rgb = pixels.flat_map(|(x, y)| [mean(x, y, 0), mean(x, y, 1), mean(x, y, 2)]).collect();
        TrainView::new(drawn, Photo { width: drawn.width, height: drawn.height, rgb })
    };
    let by_hand = unmasked.iter().map(small).collect();
    // The first iteration uses the whole picture, and makes no step here.
    let fixed = TrainSettings { strategy: StrategyType::Fixed, ..settings() };
    let still = |warm_up| TrainSettings { warm_up, ..without_rates(fixed.clone()) };
    assert_eq!(losses(by_hand, still(0))[1..], losses(unmasked, still(12))[1..]);
}

/// In a short run, half is left for whole pictures.
#[test]
fn warm_up_ends_by_half_of_the_run() {
    let long = TrainSettings { warm_up: 500, ..settings() };
    let shorter = TrainSettings { warm_up: 10, ..settings() };
    let end = |settings: TrainSettings| run(settings).end(&[]).gaussians;
    let [half, limited, other] = [settings(), long, shorter].map(end);
    assert!(half == limited && half != other);
}

#[test]
fn warm_up_refuses_depths() {
    let map = vec![0.5; PIXELS];
    let views = large()
        .into_iter()
        .map(|view| TrainView { inverse_depth: Some(map.clone().into()), ..view })
        .collect();
    let said = refusal(Run { views, ..run(settings()) }.try_begin());
    let expected = "warm_up: is 12 (preset fast sets it), which does not go together with depths";
    assert!(said.starts_with(expected), "{said}");
}
