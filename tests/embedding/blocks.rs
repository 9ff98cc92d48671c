//! Recorded training of a scene block.

use crate::host::{HostOptions, InFlight};
use crate::stage::{cloud, guest, options, own_device, with_host};
use crate::training::{settings, step, views};
use ashsplat::glam::Vec3;
use ashsplat::scene::Bounds;
use ashsplat::trainer::{SceneBlock, StepReservation, TrainParts, Trainer};
use ashsplat::vk::Context;

/// Trainer of half a scene, with the other half frozen.
fn trainer(context: &Context) -> Trainer {
    let core = Bounds { min: Vec3::NEG_INFINITY, max: Vec3::new(0.0, f32::INFINITY, f32::INFINITY) };
    let (initial, block) = SceneBlock::divide(&cloud(300, 5), core, 0.2).expect("a block");
    assert!(initial.len() > 50 && block.frozen.len() > 50);
    let parts = TrainParts::of_settings(context, &settings()).expect("parts");
    let parts = TrainParts { block: Some(block), ..parts };
    Trainer::with_parts(context, views(), &initial, 4.0, settings(), parts).expect("a trainer")
}

#[test]
fn recorded_training_of_a_block_is_the_owned_paths_to_the_bit() {
    for push_descriptors in [true, false] {
        with_host(&HostOptions { push_descriptors, ..options() }, |host| {
            let context = guest(host);
            let mut owned = trainer(own_device());
            let mut recorded = trainer(&context);
            recorded.reserve_steps(&StepReservation { slots: 1, instances: 0, visible: 0 }).expect("memory");
            let in_flight = InFlight::new(host).expect("a command buffer");
            let mut added = 0;
            for _ in 0..45 {
                let expected = owned.step().expect("a step");
                if recorded.maintenance_is_due().expect("an answer") {
                    let densified = recorded.maintain().expect("maintained").densified;
                    added += densified.map_or(0, |densified| densified.cloned + densified.split);
                }
                let got = step(host, &mut recorded, &context, &in_flight);
                assert_eq!((got.iteration, got.gaussians), (expected.iteration, expected.gaussians));
                assert_eq!(got.loss.to_bits(), expected.loss.to_bits(), "iteration {}", got.iteration);
            }
            assert!(added > 0, "nothing was added");
            let states = [&recorded, &owned].map(|trainer| trainer.checkpoint().expect("a state"));
            assert!(states[0] == states[1], "other bits");
            in_flight.destroy(host);
        });
    }
}
