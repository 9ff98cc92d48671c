//! Training steps in a host's command buffer.

mod discarded;
mod visible;

use crate::host::{Host, HostOptions, InFlight};
use crate::stage::{adopt, assert_same, camera, cloud, guest, options, own_device, rendered, with_host};
use ashsplat::trainer::{
    OptimizerType, Preset, SplitType, StepOutcome, StepReservation, StrategyType, Trainer,
};
use ashsplat::vk::{Context, ContextOptions, ForeignDevice, LimitsOverride};
use ashsplat::{
    Blending, Error, Placed, RecordedFrame, RenderSettings, Renderer, Reservation, StepReport, TrainSettings,
    TrainView,
};
use ashsplat_files::{Photo, PhotoMemory, StoredPhoto};

/// Densifies after 20, 40, 60, 80; resets opacities after 50.
pub fn settings() -> TrainSettings {
    TrainSettings {
        iterations: 100,
        sh_degree: 2,
        sh_degree_interval: 15,
        densify_from_iter: 10,
        densification_interval: 20,
        densify_until_iter: 85,
        opacity_reset_interval: 50,
        densify_grad_threshold: 2e-5,
        random_background: true,
        seed: 3,
        ..TrainSettings::default()
    }
}

/// Photographs of different sizes with a few patterns, one with a mask. The result of the training does not matter.
pub fn views() -> Vec<TrainView> {
    let view = |number: u32| {
        let (width, height) = (40 + 8 * number, 36);
        let mask = (number == 2).then(|| (0..width * height).map(|k| 255 * u8::from(k % 5 > 0)).collect());
        let rgb = (0..width * height * 3).map(|k| (k * (number + 2) / 7) as u8).collect();
        let photo = StoredPhoto::new(Photo { width, height, rgb }, mask);
        TrainView::new(camera(number as f32, width, height), photo)
    };
    (0..4).map(view).collect()
}

pub fn trainer(context: &Context, settings: TrainSettings) -> Trainer {
    let mut views = views();
    views[2].camera_id = 4;
    views[1].inverse_depth = settings.exposure.then(|| vec![0.25; 48 * 36].into());
    views[1].depth_points = (settings.depth_points > 0.0).then(|| crate::stage::depth_points().into());
    Trainer::new(context, views, &cloud(300, 5), 4.0, settings).expect("a trainer")
}

fn done(trainer: &mut Trainer, slot: u32) -> StepReport {
    match trainer.step_outcome(slot).expect("an outcome").expect("finished") {
        StepOutcome::Done(report) => report,
        StepOutcome::Overflowed { .. } => panic!("no room"),
    }
}

/// Records and executes one step in slot 0.
pub fn step(host: &Host, trainer: &mut Trainer, context: &Context, in_flight: &InFlight) -> StepReport {
    in_flight.begin(host).expect("recording");
    trainer.record_step(adopt(context, in_flight), 0).expect("a recording");
    in_flight.submit(host).expect("a submission");
    in_flight.wait(host).expect("done");
    done(trainer, 0)
}

/// Steps of a preset's run of 440 iterations that begin with the prunings due after 300 and 308.
const LATE_PRUNINGS: [usize; 2] = [301, 309];

/// Trains with one step in flight per slot, and runs maintenance whenever due.
fn train_recorded(host: &Host, settings: &TrainSettings) {
    const SLOTS: usize = 3;
    // Trains until the special events of these settings have occurred.
    let steps = match settings {
        s if s.late_min_opacity > 0.0 => 312,
        s if s.filter_3d => 104,
        s if s.strategy == StrategyType::Budget => 100,
        _ => 62,
    };
    let context = guest(host);
    let mut owned = trainer(own_device(), settings.clone());
    let expected: Vec<StepReport> = (0..steps).map(|_| owned.step().expect("a step")).collect();
    let mut recorded = trainer(&context, settings.clone());
    recorded
        .reserve_steps(&StepReservation { slots: SLOTS as u32, instances: 0, visible: 0 })
        .expect("memory");
    let frames = [0; SLOTS].map(|_| InFlight::new(host).expect("a command buffer"));
    let (mut pending, mut densifications) = (Vec::<(usize, u32)>::new(), 0);
    let check = |trainer: &mut Trainer, (slot, iteration): (usize, u32)| {
        frames[slot].wait(host).expect("done");
        let (got, wanted) = (done(trainer, slot as u32), &expected[iteration as usize - 1]);
        assert_eq!(got.iteration, iteration);
        let sizes = |r: &StepReport| (r.gaussians, r.visible, r.instances, r.skipped_non_finite);
        let numbers = |r: &StepReport| (r.iteration, r.view, r.loss.to_bits(), sizes(r));
        assert_eq!(numbers(&got), numbers(wanted), "iteration {iteration}");
    };
    for number in 0..steps {
        let slot = number % SLOTS;
        if recorded.maintenance_is_due().expect("an answer") {
            for step in pending.drain(..) {
                check(&mut recorded, step);
            }
            let maintenance = recorded.maintain().expect("maintained");
            densifications += u32::from(maintenance.densified.is_some_and(|d| d.cloned + d.split > 0));
            assert!(!recorded.maintenance_is_due().expect("an answer"));
            assert_eq!(recorded.maintain().expect("nothing to do"), Default::default());
        } else if pending.len() == SLOTS {
            check(&mut recorded, pending.remove(0));
        }
        frames[slot].begin(host).expect("recording");
        let step = recorded.record_step(adopt(&context, &frames[slot]), slot as u32).expect("a recording");
        frames[slot].submit(host).expect("a submission");
        pending.push((slot, step.iteration));
    }
    for step in pending.drain(..) {
        check(&mut recorded, step);
    }
    assert!(densifications >= 3, "{densifications} densifications changed something");
    if settings.late_min_opacity > 0.0 {
        let pruned = |step: usize| expected[step - 1].densified.is_some_and(|d| d.kept < d.before);
        assert!(LATE_PRUNINGS.iter().all(|&step| pruned(step)), "nothing was pruned late");
    }
    assert_eq!(recorded.settle().expect("an answer"), 0);
    let (got, wanted) = (recorded.checkpoint().expect("a state"), owned.checkpoint().expect("a state"));
    assert!(got == wanted, "after {} iterations: other bits", got.iteration);
    frames.into_iter().for_each(|frame| frame.destroy(host));
}

#[test]
fn recorded_training_is_the_owned_paths_to_the_bit() {
    // Terms of the loss that depend directly on the parameters.
    let weighted = TrainSettings { opacity_reg: 0.01, scale_reg: 0.01, ..settings() };
    let mcmc = TrainSettings { strategy: StrategyType::Mcmc, ..settings() };
    // Filters, whose sizes are computed between steps and within them.
    let filtered = TrainSettings {
        antialiasing: true,
        kernel_size: 0.1,
        filter_3d: true,
        densification_interval: 10,
        densify_until_iter: 45,
        iterations: 500,
        ..settings()
    };
    // Budgeted growth, which adds up gradients over several steps after 66 and 80, later than all other events.
    let budget = TrainSettings {
        strategy: StrategyType::Budget,
        scale_schedule: true,
        densify_until_iter: 19_500,
        absgrad: true,
        split: SplitType::LongAxis,
        multi_step: true,
        ..settings()
    };
    // A user's preset, but with a longer mean: it prunes faint Gaussians after 300 and 308, and averages afterwards.
    let preset = TrainSettings {
        iterations: 440,
        sh_degree: 2,
        sh_degree_interval: 15,
        scale_sh_degree: false,
        densification_interval: 20,
        densify_until_iter: 20_700,
        densify_grad_threshold: 2e-5,
        min_opacity: 0.0,
        average_last: 0.3,
        ..TrainSettings::of_preset(Preset::Default)
    };
    let sparse = TrainSettings { optimizer_type: OptimizerType::SparseAdam, ..settings() };
    let exposed = TrainSettings { exposure: true, ..settings() };
    let few = TrainSettings { dropout: 0.3, depth_points: 0.1, ..settings() };
    let all = TrainSettings { lens_effects: true, pose_opt: true, pose_lr: 1e-3, ..exposed.clone() };
    let lit = TrainSettings { lens_effects: true, pose_opt: true, exposure: true, ..budget.clone() };
    let plain = [weighted, all, lit].map(|settings| (false, settings));
    let averaged = TrainSettings { iterations: 62, average_last: 0.4, ..exposed.clone() };
    let usual = [settings(), mcmc, filtered, exposed, averaged, budget, few, sparse, preset]
        .map(|settings| (true, settings));
    for (push_descriptors, settings) in usual.into_iter().chain(plain) {
        with_host(&HostOptions { push_descriptors, ..options() }, |host| train_recorded(host, &settings));
    }
}

/// Another form of blending needs other kernels. Steps can be recorded again once they are built, with the same
/// bits.
#[test]
fn another_form_of_blending_is_due_maintenance() {
    with_host(&options(), |host| {
        let context = guest(host);
        let [own, other] = Blending::ALL;
        let (mut recorded, mut expected) = (trainer(&context, settings()), trainer(&context, settings()));
        recorded.reserve_steps(&StepReservation { slots: 1, instances: 0, visible: 0 }).expect("memory");
        let frame = InFlight::new(host).expect("a command buffer");
        // Nothing is due if nothing changes.
        recorded.set_blending(own);
        assert!(!recorded.maintenance_is_due().expect("an answer"));
        // A recorded step keeps its form.
        frame.begin(host).expect("recording");
        recorded.record_step(adopt(&context, &frame), 0).expect("a recording");
        recorded.set_blending(other);
        frame.submit(host).expect("a submission");
        frame.wait(host).expect("done");
        let first = done(&mut recorded, 0);
        assert!(recorded.maintenance_is_due().expect("an answer"));
        let refused = InFlight::new(host).expect("a command buffer");
        refused.begin(host).expect("recording");
        let error = recorded.record_step(adopt(&context, &refused), 0).expect_err("no kernels");
        assert!(error.to_string().contains("maintain"), "{error}");
        refused.destroy(host);
        recorded.maintain().expect("kernels");
        let second = step(host, &mut recorded, &context, &frame);
        expected.step().expect("a step");
        expected.set_blending(other);
        let wanted = expected.step().expect("a step");
        assert_eq!((first.iteration, second.iteration), (1, 2));
        assert_eq!(second.loss.to_bits(), wanted.loss.to_bits());
        assert!(recorded.checkpoint().expect("a state") == expected.checkpoint().expect("a state"));
        frame.destroy(host);
    });
}

/// A step without capacity changes nothing, nor do the steps behind it. All are recorded before the first one runs.
#[test]
fn steps_without_room_change_nothing() {
    with_host(&options(), |host| {
        let context = guest(host);
        let (mut recorded, mut expected) = (trainer(&context, settings()), trainer(&context, settings()));
        recorded.reserve_steps(&StepReservation { slots: 3, instances: 20, visible: 0 }).expect("memory");
        let before = recorded.checkpoint().expect("a state");
        let frames = [0; 3].map(|_| InFlight::new(host).expect("a command buffer"));
        for (slot, frame) in (0..).zip(&frames) {
            frame.begin(host).expect("recording");
            recorded.record_step(adopt(&context, frame), slot).expect("a recording");
        }
        frames.iter().for_each(|frame| frame.submit(host).expect("a submission"));
        frames.iter().for_each(|frame| frame.wait(host).expect("done"));
        for slot in 0..3 {
            let outcome = recorded.step_outcome(slot).expect("an outcome").expect("finished");
            let StepOutcome::Overflowed { iteration, instances_needed, instance_capacity, .. } = outcome
            else {
                panic!("{outcome:?}");
            };
            assert_eq!((iteration, instance_capacity), (slot + 1, 20));
            assert!(instances_needed > 20);
        }
        assert_eq!(recorded.iteration(), 0);
        assert!(
            recorded.checkpoint().expect("a state") == before,
            "a step without room has changed something"
        );
        assert!(recorded.maintenance_is_due().expect("an answer"));
        frames[0].begin(host).expect("recording");
        let error = recorded.record_step(adopt(&context, &frames[0]), 0).expect_err("no room");
        assert!(error.to_string().contains("maintain"), "{error}");
        assert!(recorded.maintain().expect("room").grown);
        for frame in &frames[1..] {
            step(host, &mut recorded, &context, frame);
            expected.step().expect("a step");
        }
        let (got, mut wanted) =
            (recorded.checkpoint().expect("a state"), expected.checkpoint().expect("a state"));
        // This trainer had to grow more.
        wanted.room = got.room;
        assert!(got == wanted, "other bits after more room");
        frames.into_iter().for_each(|frame| frame.destroy(host));
    });
}

/// Views whose frames have more instances than a binding holds are skipped, as by [`Trainer::step`].
#[test]
fn steps_that_no_room_suffices_for_are_left_out() {
    const INSTANCES: u32 = 6400;
    with_host(&options(), |host| {
        let limits = LimitsOverride {
            max_storage_buffer_range: Some(u64::from(INSTANCES) * 16),
            ..LimitsOverride::default()
        };
        let options = ContextOptions { limits_override: Some(limits), ..ContextOptions::default() };
        // SAFETY: as in `guest`.
        let context = unsafe { Context::from_foreign(&host.foreign(), &options) }.expect("a context");
        // All Gaussians in all tiles: nine tiles in two views, twelve in the others.
        let mut scene = cloud(600, 5);
        scene.log_scales.iter_mut().flatten().for_each(|s| *s += 3.5);
        let begin = |seed| {
            let settings = TrainSettings { seed, ..settings() };
            Trainer::new(&context, views(), &scene, 4.0, settings).expect("a trainer")
        };
        let seed = (0..20).find(|&seed| begin(seed).step().is_ok()).expect("a small view comes first");
        let (mut owned, mut recorded) = (begin(seed), begin(seed));
        let expected: Vec<StepReport> = (0..24).map(|_| owned.step().expect("a step")).collect();
        recorded.reserve_steps(&StepReservation { slots: 1, instances: 0, visible: 0 }).expect("memory");
        let in_flight = InFlight::new(host).expect("a command buffer");
        let mut skipped = Vec::new();
        while recorded.iteration() < 24 {
            if recorded.maintenance_is_due().expect("an answer") {
                skipped.extend(recorded.maintain().expect("maintained").skipped);
                continue;
            }
            in_flight.begin(host).expect("recording");
            recorded.record_step(adopt(&context, &in_flight), 0).expect("a recording");
            in_flight.submit(host).expect("a submission");
            in_flight.wait(host).expect("done");
            recorded.settle().expect("an answer");
        }
        let wanted: Vec<u32> = expected.iter().filter(|r| r.skipped).map(|r| r.iteration).collect();
        assert!(skipped == wanted && wanted.len() >= 8, "{skipped:?} {wanted:?}");
        assert!(expected.iter().all(|r| r.skipped == (r.instances > INSTANCES)), "{expected:?}");
        let (got, mut wanted) =
            (recorded.checkpoint().expect("a state"), owned.checkpoint().expect("a state"));
        wanted.room = got.room;
        assert!(got == wanted, "other bits");
        in_flight.destroy(host);
    });
}

/// A host renders the Gaussians in the command buffer that trains them.
#[test]
fn a_host_renders_what_it_trains() {
    with_host(&options(), |host| {
        let context = guest(host);
        let (mut recorded, mut expected) = (trainer(&context, settings()), trainer(&context, settings()));
        recorded.reserve_steps(&StepReservation::default()).expect("memory");
        let mut renderer = Renderer::new(&context).expect("kernels");
        renderer.reserve(&Reservation::new(4096, 2, 80, 60)).expect("memory");
        let in_flight = InFlight::new(host).expect("a command buffer");
        let view = camera(0.7, 80, 60);
        for _ in 0..42 {
            if recorded.maintenance_is_due().expect("an answer") {
                recorded.maintain().expect("maintained");
            }
            in_flight.begin(host).expect("recording");
            recorded.record_step(adopt(&context, &in_flight), 0).expect("a recording");
            let (scene, settings) = (recorded.scene(), RenderSettings::default());
            let placed = [Placed::from(&scene)];
            let frame = RecordedFrame::new(&placed, &view, &settings);
            renderer.record(adopt(&context, &in_flight), 0, &frame).expect("a recording");
            in_flight.submit(host).expect("a submission");
            in_flight.wait(host).expect("done");
            assert_eq!(done(&mut recorded, 0).iteration, expected.step().expect("a step").iteration);
        }
        let settings = RenderSettings { sh_degree: Some(recorded.sh_degree()), ..RenderSettings::default() };
        let wanted = expected.render(&view, &settings).expect("a frame");
        assert_eq!(recorded.render(&view, &settings).expect("a frame").color, wanted.color);
        let (scene, placed);
        scene = recorded.scene();
        placed = [Placed::from(&scene)];
        let pixels = rendered(host, &mut renderer, &RecordedFrame::new(&placed, &view, &settings));
        assert_same(&pixels, &wanted, settings.background);
        in_flight.destroy(host);
    });
}

#[test]
fn bad_steps_are_refused_before_anything_is_recorded() {
    with_host(&options(), |host| {
        let (context, other) = (guest(host), guest(host));
        let quick = TrainSettings { densify_from_iter: 0, densification_interval: 2, ..settings() };
        let mut training = trainer(&context, quick.clone());
        let in_flight = InFlight::new(host).expect("a command buffer");
        in_flight.begin(host).expect("recording");
        let refused = |training: &mut Trainer, context: &Context, slot: u32, expected: &str| {
            let error = training.record_step(adopt(context, &in_flight), slot).expect_err(expected);
            assert!(matches!(error, Error::Argument { .. }), "{error:?}");
            assert!(error.to_string().contains(expected), "{error}");
        };
        refused(&mut training, &context, 0, "reserve_steps");
        let none = training
            .reserve_steps(&StepReservation { slots: 0, instances: 0, visible: 0 })
            .expect_err("none");
        assert!(none.to_string().contains("slots: is 0, it may be 1 to 1024"), "{none}");
        training.reserve_steps(&StepReservation::default()).expect("memory");
        refused(&mut training, &other, 0, "commands: it belongs to another context");
        refused(&mut training, &context, 2, "2: 2 are reserved");
        training.record_step(adopt(&context, &in_flight), 0).expect("a recording");
        refused(&mut training, &context, 0, "still in flight");
        training.record_step(adopt(&context, &in_flight), 1).expect("a recording");
        let unsettled = [
            training.step().err(),
            training.gaussians().err(),
            training.checkpoint().err(),
            training.maintain().err(),
            training.reserve_steps(&StepReservation::default()).err(),
            training.render(&camera(0.0, 8, 8), &RenderSettings::default()).err(),
        ];
        for error in unsettled {
            assert!(error.expect("refused").to_string().contains("in flight"));
        }
        in_flight.submit(host).expect("a submission");
        in_flight.wait(host).expect("done");
        assert_eq!(done(&mut training, 1).iteration, 2);
        in_flight.begin(host).expect("recording");
        refused(&mut training, &context, 0, "maintenance is due");
        assert!(training.maintain().expect("maintained").densified.is_some());
        training.record_step(adopt(&context, &in_flight), 0).expect("a recording");
        in_flight.submit(host).expect("a submission");
        in_flight.wait(host).expect("done");
        assert_eq!(done(&mut training, 0).iteration, 3);

        // After the last step, no maintenance is required first.
        let mut ending = trainer(&context, TrainSettings { iterations: 2, ..quick });
        ending.reserve_steps(&StepReservation::default()).expect("memory");
        assert_eq!([0; 2].map(|_| step(host, &mut ending, &context, &in_flight).iteration), [1, 2]);
        assert!(ending.maintenance_is_due().expect("an answer"));
        in_flight.begin(host).expect("recording");
        refused(&mut ending, &context, 0, "training step: the run is over: its settings have 2 iterations");
        in_flight.submit(host).expect("a submission");
        in_flight.wait(host).expect("done");
        in_flight.destroy(host);
    });
}

/// A trainer must submit by itself from time to time.
#[test]
fn a_trainer_needs_a_queue() {
    with_host(&options(), |host| {
        let foreign = ForeignDevice { queue: None, ..host.foreign() };
        // SAFETY: as in `guest`.
        let context =
            unsafe { Context::from_foreign(&foreign, &ContextOptions::default()) }.expect("a context");
        let error = Trainer::new(&context, views(), &cloud(10, 1), 4.0, settings()).err().expect("refused");
        assert!(error.to_string().contains("queue") && matches!(error, Error::Argument { .. }), "{error}");
    });
}

/// Steps cannot be recorded if photographs are read from a file during training.
#[test]
fn photographs_in_a_file_are_refused() {
    with_host(&options(), |host| {
        let context = guest(host);
        let (mut views, folder) = (views(), tempfile::tempdir().expect("a folder"));
        let memory = PhotoMemory { bytes: 1 << 20, folder: folder.path().to_owned() };
        let file = memory.create_file().expect("a file");
        for view in &mut views {
            view.photo = file.store(&view.photo).expect("stored");
        }
        let mut trainer = Trainer::new(&context, views, &cloud(10, 1), 4.0, settings()).expect("a trainer");
        let error = trainer.reserve_steps(&StepReservation::default()).expect_err("refused");
        assert!(error.to_string().contains("lie in a file"), "{error}");
    });
}
