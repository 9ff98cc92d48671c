//! Properties that a picture must not depend on.

use crate::common::count_hits;
use crate::common::engine::settings;
use crate::common::prelude::*;
use ashsplat::BlendSamples;

const UNTURNED: [[f64; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

fn frame(scene: &[Gaussian], view: &View) -> Frame {
    let mut renderer = renderer();
    renderer.upload(&gaussians(scene)).expect("upload");
    renderer.render(&camera(view), &settings(view)).expect("a frame")
}

/// Depths differ, so the order in memory does not affect the order of blending: equal to the bit.
#[test]
fn invariant_under_the_order_of_the_gaussians() {
    let _gpu = Gpu::new();
    for (seed, extent) in [(1, Extent::Exact), (2, Extent::Reference)] {
        let view = View { extent, ..small_view([100, 70]) };
        let mut scene = small_scene(&mut Random::new(seed), 400, 16);
        let before = frame(&scene, &view);
        scene.reverse();
        scene.rotate_left(123);
        let after = frame(&scene, &view);
        assert!(before.color == after.color && before.transmittance == after.transmittance, "{extent:?}");
        assert!(before.inverse_depth == after.inverse_depth, "{extent:?}");
    }
}

/// Gaussians of equal depth are blended in memory order.
#[test]
fn invariant_ties_follow_the_order_of_the_gaussians() {
    let _gpu = Gpu::new();
    let view = View { camera_from_world: UNTURNED, ..small_view([40, 30]) };
    let mut scene = small_scene(&mut Random::new(3), 60, 1);
    for gaussian in &mut scene {
        gaussian.mean[2] = 0.5;
    }
    let expected = crate::reference::pipeline::render(&scene, &view);
    let actual = frame(&scene, &view);
    let off = |channel: usize| {
        let pixels = actual.color.iter().zip(&expected.pixels);
        pixels.map(move |(actual, expected)| (f64::from(actual[channel]) - expected.color[channel]).abs())
    };
    for channel in 0..3 {
        let worst = off(channel).fold(0.0, f64::max);
        assert!(worst < 2e-2, "channel {channel}: {worst}");
    }
    let mean = off(0).sum::<f64>() / actual.color.len() as f64;
    assert!(mean < 1e-5, "{mean:e}");
}

/// Gaussians that cover the picture are blended at each pixel, forward and backward. Samples are only counted on
/// request, and counting changes nothing.
#[test]
fn invariant_under_counting_samples() {
    let view = View { camera_from_world: UNTURNED, ..small_view([64, 48]) };
    let mut scene = small_scene(&mut Random::new(6), 3, 1);
    for gaussian in &mut scene {
        gaussian.log_scale = [4.0; 3];
        gaussian.opacity_logit = -3.0;
        gaussian.mean = [0.0, 0.0, 5.0];
    }
    let run = |overrides: Vec<SpecOverride>| {
        let context = Context::new(&ContextOptions { overrides, ..options() }).expect("a device");
        let mut renderer = loaded(&context, &gaussians(&scene));
        let frame = renderer.render(&camera(&view), &settings(&view)).expect("a frame");
        let photo = Photo { width: 64, height: 48, rgb: vec![100; 64 * 48 * 3] };
        let views = vec![TrainView::new(camera(&view), photo)];
        let settings = TrainSettings { sh_degree: 0, ..TrainSettings::reference() };
        let run = Run::new(&context, views, settings).starting_at(&gaussians(&scene));
        let step = run.begin().steps(1).remove(0);
        (frame.color, frame.stats.samples, step.samples, step.loss.to_bits())
    };
    let (counted, silent) = (run(vec![count_hits()]), run(Vec::new()));
    let samples = 3 * 64 * 48;
    assert_eq!(counted.1, BlendSamples { forward: samples, backward: 0 });
    assert_eq!(counted.2, BlendSamples { forward: samples, backward: samples });
    assert_eq!((silent.1, silent.2), Default::default());
    assert!(counted.0 == silent.0 && counted.3 == silent.3);
}
