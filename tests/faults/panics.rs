//! Caught panics do not affect later work.

use std::panic::{AssertUnwindSafe, catch_unwind};

use ashsplat::trainer::{SplitType, Trainer};
use ashsplat::vk::Fault;
use ashsplat::{RenderSettings, TrainSettings};

use super::{close, device};
use crate::checkpoints::{settings, start, views};

/// A viewer's picture between two steps panics; later steps have the same bits. With absolute gradients, frames of
/// training have buffers that pictures lack.
#[test]
fn faults_that_panic_in_a_picture_leave_training_as_it_is() {
    let (context, faults) = device();
    let settings = TrainSettings { absgrad: true, split: SplitType::LongAxis, ..settings() };
    let camera = views(1, 9)[0].camera;
    let run = |panics: bool| {
        let mut trainer =
            Trainer::new(&context, views(3, 9), &start(), 5.0, settings.clone()).expect("a trainer");
        (0..12).for_each(|_| drop(trainer.step().expect("a step")));
        if panics {
            faults.disarm();
            faults.arm(Fault::Panic, 0);
            let picture =
                catch_unwind(AssertUnwindSafe(|| trainer.render(&camera, &RenderSettings::default())));
            assert!(picture.is_err() && faults.calls(Fault::Panic) == 1);
            faults.disarm();
        }
        (0..12).for_each(|_| drop(trainer.step().expect("a step")));
        trainer.render(&camera, &RenderSettings::default()).expect("a picture");
        trainer.gaussians().expect("Gaussians")
    };
    let whole = run(false);
    assert!(run(true) == whole, "other bits");
    close(context);
}
