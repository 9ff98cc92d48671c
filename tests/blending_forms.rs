//! The two forms of blending train to the same bits, with different work.

use crate::common::count_hits;
use crate::common::prelude::*;
use ashsplat::Blending;
use ashsplat::frame::tuning::Backend;

/// A device that counts blended samples: the count reveals which kernel ran.
fn counting() -> Context {
    let options = ContextOptions { overrides: vec![count_hits()], ..options() };
    Context::new(&options).expect("a device")
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
