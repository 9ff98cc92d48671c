//! The two forms of blending give the same bits in renderer and trainer, with different work.

use crate::common::blending::assert_same;
use crate::common::count_hits;
use crate::common::engine::{derivatives, settings};
use crate::common::prelude::*;
use ashsplat::Blending;
use ashsplat::frame::tuning::Backend;

/// A device that counts blended samples: the count reveals which kernel ran.
fn counting() -> Context {
    let options = ContextOptions { overrides: vec![count_hits()], ..options() };
    Context::new(&options).expect("a device")
}

fn values(frame: &Frame) -> Vec<f32> {
    let depth = frame.inverse_depth.iter().flatten();
    frame.color.iter().flatten().chain(&frame.transmittance).chain(depth).copied().collect()
}

#[test]
fn blending_forms_draw_the_same_picture_with_other_work() {
    let context = counting();
    let mut renderer = Renderer::new(&context).expect("kernels");
    let view = small_view([150, 90]);
    let target = vec![[0.5, -1.0, 0.25]; 150 * 90];
    for (seed, count) in [(31, 3000), (32, 300)] {
        renderer.upload(&gaussians(&mixed_scene(&mut Random::new(seed), count, 9))).expect("upload");
        let [regions, shared] = Blending::ALL.map(|form| {
            renderer.set_blending(form);
            let frame = renderer.render(&camera(&view), &settings(&view)).expect("a picture");
            let gradients = renderer.gradients(&camera(&view), &settings(&view), &target, None);
            (frame, gradients.expect("gradients"))
        });
        assert!(regions.0.color.iter().flatten().filter(|x| **x > 0.1).count() > 1000, "little to be seen");
        assert_same(&context, &values(&regions.0), &values(&shared.0), ("the pictures", 1e-5));
        let [of_regions, of_shared] = [&regions.1, &shared.1].map(|all| derivatives(all).concat());
        assert!(of_regions.iter().any(|d| *d != 0.0));
        assert_same(&context, &of_regions, &of_shared, ("the gradients", 1e-3));
        let samples = |frame: &Frame| frame.stats.samples.forward;
        // A region skips entries that miss it; the form with one tile per workgroup walks its whole list.
        assert!(samples(&regions.0) > 0 && samples(&shared.0) > samples(&regions.0), "seed {seed}");
    }
}

/// Trains with one form, and from an iteration on with another. Returns samples of each half and the results.
fn train(context: &Context, [first, then]: [Blending; 2]) -> ([u64; 2], Vec<u32>, Gaussians) {
    let view = |number: u32| {
        let rgb = (0..56 * 40 * 3).map(|k| (k * (number + 2) / 7) as u8).collect();
        TrainView::new(camera(&small_view([56, 40])), Photo { width: 56, height: 40, rgb })
    };
    let settings = TrainSettings {
        iterations: 40,
        sh_degree: 1,
        sh_degree_interval: 10,
        densify_from_iter: 5,
        densification_interval: 10,
        densify_until_iter: 35,
        opacity_reset_interval: 15,
        densify_grad_threshold: 2e-5,
        ..TrainSettings::reference()
    };
    let start = gaussians(&small_scene(&mut Random::new(34), 200, 4));
    let mut trainer = Run { start, ..Run::new(context, vec![view(0), view(1)], settings) }.begin();
    let halves = [first, then].map(|form| {
        trainer.set_blending(form);
        trainer.steps(20)
    });
    let samples = halves.each_ref().map(|half| half.iter().map(|report| report.samples.forward).sum());
    let losses = halves.iter().flatten().map(|report| report.loss.to_bits()).collect();
    (samples, losses, trainer.trained())
}

#[test]
fn blending_forms_train_to_the_same_bits() {
    let context = counting();
    let [regions, shared] = Blending::ALL.map(|form| train(&context, [form; 2]));
    let mixed = train(&context, Blending::ALL);
    if context.limits().tuning.backend == Backend::Processor {
        assert!(regions.1 == shared.1 && regions.1 == mixed.1, "the losses differ");
        assert!(regions.2 == shared.2 && regions.2 == mixed.2, "the Gaussians differ");
        assert_eq!(mixed.0, [regions.0[0], shared.0[1]]);
    }
    assert_ne!(regions.2.len(), 200, "nothing was densified");
    // Each half has the sample count of its form.
    assert!(regions.0.iter().zip(&shared.0).all(|(regions, shared)| 0 < *regions && regions < shared));
}
