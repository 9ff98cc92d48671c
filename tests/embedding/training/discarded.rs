//! Recorded steps that are discarded, in time and too late.

use super::*;

/// A discarded command buffer takes back its steps; later ones must be discarded, too.
#[test]
fn steps_that_are_thrown_away_are_recorded_again() {
    with_host(&options(), |host| {
        let context = guest(host);
        let (mut recorded, mut expected) = (trainer(&context, settings()), trainer(&context, settings()));
        recorded.reserve_steps(&StepReservation::default()).expect("memory");
        let record_and_throw_away = |trainer: &mut Trainer| {
            for slot in 0..2 {
                let frame = InFlight::new(host).expect("a command buffer");
                frame.begin(host).expect("recording");
                trainer.record_step(adopt(&context, &frame), slot).expect("a recording");
                frame.destroy(host);
            }
        };
        record_and_throw_away(&mut recorded);
        for slot in 0..2 {
            // SAFETY: neither command buffer was submitted: both are gone.
            unsafe { recorded.step_recording(slot).expect("a slot").discard() };
        }
        assert_eq!((recorded.settle().expect("none"), recorded.iteration()), (0, 0));
        let in_flight = InFlight::new(host).expect("a command buffer");
        for _ in 0..2 {
            let wanted = expected.step().expect("a step");
            let got = step(host, &mut recorded, &context, &in_flight);
            assert_eq!((got.iteration, got.loss.to_bits()), (wanted.iteration, wanted.loss.to_bits()));
        }
        record_and_throw_away(&mut recorded);
        // SAFETY: as above.
        unsafe { recorded.step_recording(0).expect("a slot").discard() };
        let error = recorded.settle().expect_err("the second is still there");
        assert!(error.to_string().contains("thrown away"), "{error}");
        assert!(recorded.step().is_err());
        in_flight.destroy(host);
    });
}

/// Executed steps cannot be taken back.
#[test]
fn steps_that_are_discarded_too_late_break_the_trainer() {
    with_host(&options(), |host| {
        let context = guest(host);
        let mut recorded = trainer(&context, settings());
        recorded.reserve_steps(&StepReservation::default()).expect("memory");
        let frame = InFlight::new(host).expect("a command buffer");
        frame.begin(host).expect("recording");
        recorded.record_step(adopt(&context, &frame), 0).expect("a recording");
        frame.submit(host).expect("a submission");
        frame.wait(host).expect("done");
        // SAFETY: the execution is over.
        unsafe { recorded.step_recording(0).expect("a slot").discard() };
        let error = recorded.settle().expect_err("it has changed the scene");
        assert!(error.to_string().contains("executed"), "{error}");
        assert!(recorded.step().is_err());
        frame.destroy(host);
    });
}
