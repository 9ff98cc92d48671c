//! Recorded training steps of a run that starts with small pictures.

use crate::host::InFlight;
use crate::stage::{adopt, camera, cloud, guest, options, with_host};
use ashsplat::trainer::{StepReservation, StrategyType, Trainer};
use ashsplat::vk::Context;
use ashsplat::{TrainSettings, TrainView};
use ashsplat_files::Photo;

const ITERATIONS: u32 = 16;

fn trainer(context: &Context) -> Trainer {
    let (width, height) = (272, 260);
    let view = |number: u32| {
        let rgb = (0..width * height * 3).map(|k| (k * (number + 2) / 700) as u8).collect();
        TrainView::new(camera(number as f32, width, height), Photo { width, height, rgb })
    };
    let settings = TrainSettings {
        iterations: ITERATIONS,
        warm_up: 8,
        strategy: StrategyType::Fixed,
        ..TrainSettings::default()
    };
    Trainer::new(context, (0..3).map(view).collect(), &cloud(300, 5), 4.0, settings).expect("a trainer")
}

/// The reservation prepares pictures of every size, whichever comes first.
#[test]
fn recorded_steps_of_a_warm_up_have_the_owned_paths_bits() {
    with_host(&options(), |host| {
        let context = guest(host);
        for begun in [0, 2, 6, 10] {
            let (mut owned, mut recorded) = (trainer(&context), trainer(&context));
            for trainer in [&mut owned, &mut recorded] {
                (0..begun).for_each(|_| drop(trainer.step().expect("a step")));
            }
            recorded.reserve_steps(&StepReservation { slots: 1, instances: 0, visible: 0 }).expect("memory");
            let frame = InFlight::new(host).expect("a command buffer");
            for _ in begun..ITERATIONS {
                let expected = owned.step().expect("a step");
                if recorded.maintenance_is_due().expect("an answer") {
                    recorded.maintain().expect("maintained");
                }
                frame.begin(host).expect("recording");
                recorded.record_step(adopt(&context, &frame), 0).expect("a recording");
                frame.submit(host).expect("a submission");
                frame.wait(host).expect("done");
                recorded.settle().expect("an answer");
                assert_eq!(recorded.iteration(), expected.iteration);
            }
            let (got, wanted) =
                (recorded.checkpoint().expect("a state"), owned.checkpoint().expect("a state"));
            assert!(got == wanted, "recorded after {begun}: other bits");
            frame.destroy(host);
        }
    });
}
