//! Recorded steps with more visible Gaussians than estimated.

use super::*;
use ashsplat::plan::LEAST_VISIBLE;

/// The first step sees more Gaussians than estimated. It changes nothing and is repeated with more capacity, to the
/// same bits.
#[test]
fn steps_that_see_more_than_estimated_are_repeated() {
    with_host(&options(), |host| {
        let context = guest(host);
        let trainer = || {
            let start = cloud(3 * LEAST_VISIBLE as usize, 5);
            Trainer::new(&context, views(), &start, 4.0, settings()).expect("a trainer")
        };
        let (mut recorded, mut expected) = (trainer(), trainer());
        recorded.reserve_steps(&StepReservation { slots: 1, instances: 0, visible: 0 }).expect("memory");
        let frame = InFlight::new(host).expect("a command buffer");
        frame.begin(host).expect("recording");
        recorded.record_step(adopt(&context, &frame), 0).expect("a recording");
        frame.submit(host).expect("a submission");
        frame.wait(host).expect("done");
        let outcome = recorded.step_outcome(0).expect("an outcome").expect("finished");
        let StepOutcome::Overflowed { iteration, visible_needed, visible_capacity, .. } = outcome else {
            panic!("{outcome:?}");
        };
        assert_eq!(iteration, 1);
        assert!(visible_needed > visible_capacity && visible_capacity >= LEAST_VISIBLE);
        while recorded.iteration() < 3 {
            if recorded.maintenance_is_due().expect("an answer") {
                assert!(recorded.maintain().expect("room").grown);
            }
            frame.begin(host).expect("recording");
            recorded.record_step(adopt(&context, &frame), 0).expect("a recording");
            frame.submit(host).expect("a submission");
            frame.wait(host).expect("done");
            recorded.settle().expect("settled");
        }
        (0..3).for_each(|_| assert!(!expected.step().expect("a step").skipped));
        assert!(recorded.gaussians().expect("Gaussians") == expected.gaussians().expect("Gaussians"));
        // With enough capacity from the start, no step is repeated.
        let mut roomy = trainer();
        let all = StepReservation { slots: 1, instances: 1 << 18, visible: 3 * LEAST_VISIBLE };
        roomy.reserve_steps(&all).expect("memory");
        for _ in 0..3 {
            frame.begin(host).expect("recording");
            roomy.record_step(adopt(&context, &frame), 0).expect("a recording");
            frame.submit(host).expect("a submission");
            frame.wait(host).expect("done");
            let outcome = roomy.step_outcome(0).expect("an outcome").expect("finished");
            assert!(matches!(outcome, StepOutcome::Done(_)), "{outcome:?}");
        }
        assert!(roomy.gaussians().expect("Gaussians") == expected.gaussians().expect("Gaussians"));
        frame.destroy(host);
    });
}
