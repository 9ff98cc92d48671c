//! Training steps in a host's command buffer.

use crate::stage::*;
use ashsplat::frame::MIN_VISIBLE;
use ashsplat::scene::Bounds;
use ashsplat::train::{
    MomentsType, OptimizerType, Preset, SceneBlock, SplitType, StepOutcome, StepReservation, StrategyType,
    TrainParts, Trainer,
};
use ashsplat::{StepReport, TrainView};
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
        ..TrainSettings::reference()
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
    views[1].depth_points = (settings.depth_points > 0.0).then(|| depth_points().into());
    Trainer::new(context, views, &cloud(300, 5), 4.0, settings).expect("a trainer")
}

fn done(trainer: &mut Trainer, slot: u32) -> StepReport {
    match trainer.step_outcome(slot).expect("an outcome").expect("finished") {
        StepOutcome::Done(report) => report,
        StepOutcome::Overflowed { .. } => panic!("no room"),
    }
}

fn execute(trainer: &mut Trainer, context: &Context, in_flight: &Commands<'_>) {
    trainer.record_step(in_flight.begun(context), 0).expect("a recording");
    in_flight.finish();
}

/// Executes one step in slot 0, which has enough capacity.
pub fn step(trainer: &mut Trainer, context: &Context, in_flight: &Commands<'_>) -> StepReport {
    execute(trainer, context, in_flight);
    done(trainer, 0)
}

/// Steps of a preset's run of 440 iterations that begin with the prunings due after 300 and 308.
const LATE_PRUNINGS: [usize; 2] = [301, 309];

/// Trains with one step in flight per slot, and runs maintenance whenever due. Returns the reports of the owned path, and
/// the number of densifications that changed something.
fn train_recorded(host: &Host, make: &dyn Fn(&Context) -> Trainer, steps: usize) -> (Vec<StepReport>, u32) {
    const SLOTS: usize = 3;
    let context = guest(host);
    let (mut owned, mut recorded) = (make(own_device()), make(&context));
    let expected: Vec<StepReport> = (0..steps).map(|_| owned.step().expect("a step")).collect();
    recorded
        .reserve_steps(&StepReservation { slots: SLOTS as u32, instances: 0, visible: 0 })
        .expect("memory");
    let frames = [0; SLOTS].map(|_| Commands::new(host));
    let (mut pending, mut densifications) = (Vec::<(usize, u32)>::new(), 0);
    let check = |trainer: &mut Trainer, (slot, iteration): (usize, u32)| {
        frames[slot].wait();
        let (got, first) = (done(trainer, slot as u32), expected[0].iteration);
        let wanted = &expected[(iteration - first) as usize];
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
        let step = recorded.record_step(frames[slot].begun(&context), slot as u32).expect("a recording");
        frames[slot].submit();
        pending.push((slot, step.iteration));
    }
    for step in pending.drain(..) {
        check(&mut recorded, step);
    }
    assert_eq!(recorded.settle().expect("an answer"), 0);
    let (got, wanted) = (recorded.checkpoint().expect("a state"), owned.checkpoint().expect("a state"));
    assert!(got == wanted, "after {} iterations: other bits", got.iteration);
    (expected, densifications)
}

#[test]
fn recorded_training_is_the_owned_paths_to_the_bit() {
    // Terms of the loss that depend directly on the parameters; halves.
    let weighted = TrainSettings {
        opacity_reg: 0.01,
        scale_reg: 0.01,
        surface: true,
        moments: MomentsType::Packed,
        sh_storage: ShStorage::Half,
        ..settings()
    };
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
    let budget = TrainSettings {
        strategy: StrategyType::Budget,
        scale_schedule: true,
        densify_until_iter: 19_500,
        absgrad: true,
        split: SplitType::LongAxis,
        ..settings()
    };
    // A user's preset. It prunes faint Gaussians after 300 and 308.
    let preset = TrainSettings {
        iterations: 440,
        sh_degree: 2,
        sh_degree_interval: 15,
        scale_sh_degree: false,
        densification_interval: 20,
        densify_until_iter: 20_700,
        densify_grad_threshold: 2e-5,
        min_opacity: 0.0,
        ..TrainSettings::of_preset(Preset::Default)
    };
    let sparse = TrainSettings { optimizer_type: OptimizerType::SparseAdam, ..settings() };
    let exposed = TrainSettings { exposure: true, ..settings() };
    let few = TrainSettings { dropout: 0.3, depth_points: 0.1, ..settings() };
    let all = TrainSettings {
        lens_effects: true,
        pose_opt: true,
        pose_lr: 1e-3,
        lens_opt: true,
        ..exposed.clone()
    };
    let plain = [weighted, all].map(|settings| (false, settings));
    let usual =
        [settings(), mcmc, filtered, exposed, budget, few, sparse, preset].map(|settings| (true, settings));
    for (push_descriptors, settings) in usual.into_iter().chain(plain) {
        // Until the special events of these settings have occurred.
        let steps = match &settings {
            s if s.late_min_opacity > 0.0 => 312,
            s if s.filter_3d => 104,
            s if s.strategy == StrategyType::Budget => 100,
            _ => 62,
        };
        with_host(&HostOptions { push_descriptors, ..options() }, |host| {
            let make = |context: &Context| trainer(context, settings.clone());
            let (reports, densifications) = train_recorded(host, &make, steps);
            assert!(densifications >= 3, "{densifications} densifications changed something");
            let pruned = |&step: &usize| reports[step - 1].densified.is_some_and(|d| d.kept < d.before);
            let prunes = settings.late_min_opacity > 0.0;
            assert!(!prunes || LATE_PRUNINGS.iter().all(pruned), "nothing was pruned late");
        });
    }
}

/// Another form of blending needs other kernels. Steps can be recorded again once they are built, with the same
/// bits.
#[test]
fn another_form_of_blending_is_due_maintenance() {
    with_guest(|host, context| {
        let [own, other] = Blending::ALL;
        let (mut recorded, mut expected) = (trainer(&context, settings()), trainer(&context, settings()));
        recorded.reserve_steps(&ONE_SLOT).expect("memory");
        let frame = Commands::new(host);
        // Nothing is due if nothing changes.
        recorded.set_blending(own);
        assert!(!recorded.maintenance_is_due().expect("an answer"));
        // A recorded step keeps its form.
        recorded.record_step(frame.begun(&context), 0).expect("a recording");
        recorded.set_blending(other);
        frame.finish();
        let first = done(&mut recorded, 0);
        assert!(recorded.maintenance_is_due().expect("an answer"));
        let refused = Commands::new(host);
        assert_error(recorded.record_step(refused.begun(&context), 0), "maintain");
        recorded.maintain().expect("kernels");
        let second = step(&mut recorded, &context, &frame);
        expected.step().expect("a step");
        expected.set_blending(other);
        let wanted = expected.step().expect("a step");
        assert_eq!((first.iteration, second.iteration), (1, 2));
        assert_eq!(second.loss.to_bits(), wanted.loss.to_bits());
        assert!(recorded.checkpoint().expect("a state") == expected.checkpoint().expect("a state"));
    });
}

/// A step without capacity changes nothing, nor do the steps behind it. All are recorded before the first one runs.
#[test]
fn steps_without_room_change_nothing() {
    with_guest(|host, context| {
        let (mut recorded, mut expected) = (trainer(&context, settings()), trainer(&context, settings()));
        recorded.reserve_steps(&StepReservation { slots: 3, instances: 20, visible: 0 }).expect("memory");
        let before = recorded.checkpoint().expect("a state");
        let frames = [0; 3].map(|_| Commands::new(host));
        for (slot, frame) in (0..).zip(&frames) {
            recorded.record_step(frame.begun(&context), slot).expect("a recording");
        }
        frames.iter().for_each(|frame| frame.submit());
        frames.iter().for_each(|frame| frame.wait());
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
        assert!(recorded.checkpoint().expect("a state") == before, "a step without room changes something");
        assert!(recorded.maintenance_is_due().expect("an answer"));
        assert_error(recorded.record_step(frames[0].begun(&context), 0), "maintain");
        assert!(recorded.maintain().expect("room").grown);
        for frame in &frames[1..] {
            step(&mut recorded, &context, frame);
            expected.step().expect("a step");
        }
        let (got, mut wanted) =
            (recorded.checkpoint().expect("a state"), expected.checkpoint().expect("a state"));
        // This trainer had to grow more.
        wanted.capacities = got.capacities;
        assert!(got == wanted, "other bits after more room");
    });
}

/// Views whose frames have more instances than a binding holds are skipped, as by [`Trainer::step`].
#[test]
fn steps_that_no_room_suffices_for_are_left_out() {
    const INSTANCES: u32 = 6400;
    with_host(&options(), |host| {
        let context = guest_of(&host.foreign(), &small_bindings(u64::from(INSTANCES) * 16));
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
        recorded.reserve_steps(&ONE_SLOT).expect("memory");
        let in_flight = Commands::new(host);
        let mut skipped = Vec::new();
        while recorded.iteration() < 24 {
            if recorded.maintenance_is_due().expect("an answer") {
                skipped.extend(recorded.maintain().expect("maintained").skipped);
                continue;
            }
            execute(&mut recorded, &context, &in_flight);
            recorded.settle().expect("an answer");
        }
        let wanted: Vec<u32> = expected.iter().filter(|r| r.skipped).map(|r| r.iteration).collect();
        assert!(skipped == wanted && wanted.len() >= 8, "{skipped:?} {wanted:?}");
        assert!(expected.iter().all(|r| r.skipped == (r.instances > INSTANCES)), "{expected:?}");
        let (got, mut wanted) =
            (recorded.checkpoint().expect("a state"), owned.checkpoint().expect("a state"));
        wanted.capacities = got.capacities;
        assert!(got == wanted, "other bits");
    });
}

/// A host renders the Gaussians in the command buffer that trains them.
#[test]
fn a_host_renders_what_it_trains() {
    with_guest(|host, context| {
        let (mut recorded, mut expected) = (trainer(&context, settings()), trainer(&context, settings()));
        recorded.reserve_steps(&StepReservation::default()).expect("memory");
        let mut renderer = reserved(&context, &Reservation::new(4096, 2, 80, 60));
        let in_flight = Commands::new(host);
        let view = camera(0.7, 80, 60);
        for _ in 0..42 {
            if recorded.maintenance_is_due().expect("an answer") {
                recorded.maintain().expect("maintained");
            }
            recorded.record_step(in_flight.begun(&context), 0).expect("a recording");
            let (scene, settings) = (recorded.scene(), RenderSettings::default());
            let placed = [Placed::from(&scene)];
            let frame = RecordedFrame::new(&placed, &view, &settings);
            renderer.record(in_flight.adopt(&context), 0, &frame).expect("a recording");
            in_flight.finish();
            assert_eq!(done(&mut recorded, 0).iteration, expected.step().expect("a step").iteration);
        }
        let settings = RenderSettings { sh_degree: Some(recorded.sh_degree()), ..RenderSettings::default() };
        let wanted = expected.render(&view, &settings).expect("a frame");
        assert_eq!(recorded.render(&view, &settings).expect("a frame").color, wanted.color);
        let (scene, placed);
        scene = recorded.scene();
        placed = [Placed::from(&scene)];
        let pixels = rendered(host, &mut renderer, &RecordedFrame::new(&placed, &view, &settings));
        assert_same(&pixels, &wanted);
    });
}

#[test]
fn bad_steps_are_refused_before_anything_is_recorded() {
    with_host(&options(), |host| {
        let (context, other) = (guest(host), guest(host));
        let quick = TrainSettings { densify_from_iter: 0, densification_interval: 2, ..settings() };
        let mut training = trainer(&context, quick.clone());
        let in_flight = Commands::new(host);
        in_flight.begin();
        let refused = |training: &mut Trainer, context: &Context, slot: u32, expected: &str| {
            let error = training.record_step(in_flight.adopt(context), slot).expect_err(expected);
            assert_argument(&error, expected);
        };
        refused(&mut training, &context, 0, "reserve_steps");
        let none = StepReservation { slots: 0, ..ONE_SLOT };
        assert_error(training.reserve_steps(&none), "slots: is 0, it may be 1 to 1024");
        training.reserve_steps(&StepReservation::default()).expect("memory");
        refused(&mut training, &other, 0, "commands: it belongs to another context");
        refused(&mut training, &context, 2, "2: 2 are reserved");
        training.record_step(in_flight.adopt(&context), 0).expect("a recording");
        refused(&mut training, &context, 0, "still in flight");
        training.record_step(in_flight.adopt(&context), 1).expect("a recording");
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
        in_flight.finish();
        assert_eq!(done(&mut training, 1).iteration, 2);
        in_flight.begin();
        refused(&mut training, &context, 0, "maintenance is due");
        assert!(training.maintain().expect("maintained").densified.is_some());
        training.record_step(in_flight.adopt(&context), 0).expect("a recording");
        in_flight.finish();
        assert_eq!(done(&mut training, 0).iteration, 3);

        // After the last step, no maintenance is required first.
        let mut ending = trainer(&context, TrainSettings { iterations: 2, ..quick });
        ending.reserve_steps(&StepReservation::default()).expect("memory");
        assert_eq!([0; 2].map(|_| step(&mut ending, &context, &in_flight).iteration), [1, 2]);
        assert!(ending.maintenance_is_due().expect("an answer"));
        in_flight.begin();
        refused(&mut ending, &context, 0, "training step: the run is over: its settings have 2 iterations");
        in_flight.finish();
    });
}

/// A trainer must submit by itself from time to time.
#[test]
fn a_trainer_needs_a_queue() {
    with_host(&options(), |host| {
        let foreign = ForeignDevice { queue: None, ..host.foreign() };
        let context = guest_of(&foreign, &ContextOptions::default());
        let error = Trainer::new(&context, views(), &cloud(10, 1), 4.0, settings()).err().expect("refused");
        assert!(error.to_string().contains("queue") && matches!(error, Error::Argument { .. }), "{error}");
    });
}

/// Steps cannot be recorded if photographs are read from a file during training.
#[test]
fn photographs_in_a_file_are_refused() {
    with_guest(|_, context| {
        let (mut views, folder) = (views(), tempfile::tempdir().expect("a folder"));
        let memory = PhotoMemory { bytes: 1 << 20, folder: folder.path().to_owned() };
        let file = memory.create_file().expect("a file");
        for view in &mut views {
            view.photo = file.store(&view.photo).expect("stored");
        }
        let mut trainer = Trainer::new(&context, views, &cloud(10, 1), 4.0, settings()).expect("a trainer");
        assert_error(trainer.reserve_steps(&StepReservation::default()), "lie in a file");
    });
}

/// The first step sees more Gaussians than estimated. It changes nothing and is repeated with more capacity, to the
/// same bits.
#[test]
fn steps_that_see_more_than_estimated_are_repeated() {
    with_guest(|host, context| {
        let trainer = || {
            let start = cloud(3 * MIN_VISIBLE as usize, 5);
            Trainer::new(&context, views(), &start, 4.0, settings()).expect("a trainer")
        };
        let (mut recorded, mut expected) = (trainer(), trainer());
        recorded.reserve_steps(&ONE_SLOT).expect("memory");
        let frame = Commands::new(host);
        execute(&mut recorded, &context, &frame);
        let outcome = recorded.step_outcome(0).expect("an outcome").expect("finished");
        let StepOutcome::Overflowed { iteration, visible_needed, visible_capacity, .. } = outcome else {
            panic!("{outcome:?}");
        };
        assert_eq!(iteration, 1);
        assert!(visible_needed > visible_capacity && visible_capacity >= MIN_VISIBLE);
        while recorded.iteration() < 3 {
            if recorded.maintenance_is_due().expect("an answer") {
                assert!(recorded.maintain().expect("room").grown);
            }
            execute(&mut recorded, &context, &frame);
            recorded.settle().expect("settled");
        }
        (0..3).for_each(|_| assert!(!expected.step().expect("a step").skipped));
        assert!(recorded.gaussians().expect("Gaussians") == expected.gaussians().expect("Gaussians"));
        // With enough capacity from the start, no step is repeated.
        let mut roomy = trainer();
        let all = StepReservation { slots: 1, instances: 1 << 18, visible: 3 * MIN_VISIBLE };
        roomy.reserve_steps(&all).expect("memory");
        for _ in 0..3 {
            execute(&mut roomy, &context, &frame);
            let outcome = roomy.step_outcome(0).expect("an outcome").expect("finished");
            assert!(matches!(outcome, StepOutcome::Done(_)), "{outcome:?}");
        }
        assert!(roomy.gaussians().expect("Gaussians") == expected.gaussians().expect("Gaussians"));
    });
}

#[test]
fn steps_that_are_thrown_away_are_recorded_again() {
    with_guest(|host, context| {
        let (mut recorded, mut expected) = (trainer(&context, settings()), trainer(&context, settings()));
        recorded.reserve_steps(&StepReservation::default()).expect("memory");
        let record_and_throw_away = |trainer: &mut Trainer| {
            for slot in 0..2 {
                let frame = Commands::new(host);
                trainer.record_step(frame.begun(&context), slot).expect("a recording");
            }
        };
        record_and_throw_away(&mut recorded);
        for slot in 0..2 {
            // SAFETY: neither command buffer was submitted: both are gone.
            unsafe { recorded.step_recording(slot).expect("a slot").discard() };
        }
        assert_eq!((recorded.settle().expect("none"), recorded.iteration()), (0, 0));
        let in_flight = Commands::new(host);
        for _ in 0..2 {
            let wanted = expected.step().expect("a step");
            let got = step(&mut recorded, &context, &in_flight);
            assert_eq!((got.iteration, got.loss.to_bits()), (wanted.iteration, wanted.loss.to_bits()));
        }
        record_and_throw_away(&mut recorded);
        // SAFETY: as above.
        unsafe { recorded.step_recording(0).expect("a slot").discard() };
        assert_error(recorded.settle(), "thrown away");
        assert!(recorded.step().is_err());
    });
}

/// Executed steps cannot be taken back.
#[test]
fn steps_that_are_discarded_too_late_break_the_trainer() {
    with_guest(|host, context| {
        let mut recorded = trainer(&context, settings());
        recorded.reserve_steps(&StepReservation::default()).expect("memory");
        let frame = Commands::new(host);
        execute(&mut recorded, &context, &frame);
        // SAFETY: the execution is over.
        unsafe { recorded.step_recording(0).expect("a slot").discard() };
        assert_error(recorded.settle(), "executed");
        assert!(recorded.step().is_err());
    });
}

const ITERATIONS: u32 = 16;

fn warm_up_trainer(context: &Context) -> Trainer {
    let (width, height) = (272, 260);
    let view = |number: u32| {
        let rgb = (0..width * height * 3).map(|k| (k * (number + 2) / 700) as u8).collect();
        TrainView::new(camera(number as f32, width, height), Photo { width, height, rgb })
    };
    let settings = TrainSettings {
        iterations: ITERATIONS,
        warm_up: 8,
        strategy: StrategyType::Fixed,
        ..TrainSettings::reference()
    };
    Trainer::new(context, (0..3).map(view).collect(), &cloud(300, 5), 4.0, settings).expect("a trainer")
}

#[test]
fn recorded_steps_of_a_warm_up_have_the_owned_paths_bits() {
    with_host(&options(), |host| {
        for begun in [0, 2, 6, 10] {
            let make = |context: &Context| {
                let mut trainer = warm_up_trainer(context);
                (0..begun).for_each(|_| drop(trainer.step().expect("a step")));
                trainer
            };
            train_recorded(host, &make, (ITERATIONS - begun) as usize);
        }
    });
}

/// Trainer of half a scene, with the other half frozen.
fn block_trainer(context: &Context) -> Trainer {
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
            let (_, densifications) = train_recorded(host, &block_trainer, 45);
            assert!(densifications > 0, "nothing was added");
        });
    }
}
