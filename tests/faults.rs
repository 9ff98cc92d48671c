//! Every Vulkan call that may fail is made to fail once. The result is a typed error, no panic, no leak. Affected
//! objects work again or report that they do not.

use crate::common::prelude::*;
use ashsplat::train::SplitType;
use ashsplat::vk::{Fault, Faults};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::Duration;

/// One in this many calls of a long list fails; `ASHSPLAT_ALL_FAULTS=1` makes each of them fail.
const STRIDE: u64 = 29;

fn stride(usual: u64) -> usize {
    if std::env::var_os("ASHSPLAT_ALL_FAULTS").is_some() { 1 } else { usual as usize }
}

/// A device whose calls can be made to fail. Transfers are staged, to have more of them. A busy machine does not
/// reach the timeout.
fn device() -> (Context, Faults) {
    device_with(options())
}

fn device_with(options: ContextOptions) -> (Context, Faults) {
    let faults = Faults::new();
    let timeout = Some(Duration::from_secs(60));
    let own = ContextOptions { faults: Some(faults.clone()), force_staging: true, timeout, ..options };
    (Context::new(&own).expect("a device"), faults)
}

/// Fails unless all memory is freed and the validation layer reports nothing, leaks included.
fn close(context: Context) {
    // After a timeout, a thread still waits for the submission and then frees its memory.
    context.free_staging();
    for _ in 0..500 {
        if context.memory().iter().all(|arena| arena.bytes == 0) {
            break;
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    assert_nothing_allocated(&context, "all");
    std::thread::sleep(Duration::from_millis(50));
    let messages = context.close().expect("the last holder");
    assert!(messages.is_empty(), "validation messages:\n{}", messages.join("\n"));
}

fn assert_nothing_allocated(context: &Context, after: &str) {
    context.free_staging();
    for arena in context.memory() {
        assert_eq!(arena.bytes, 0, "arena {} leaks after {after}", arena.name);
    }
}

/// Result of a run, and true if a densification was limited by memory, which changes it.
type Made<T> = (T, bool);

/// A picture, with a frame that must grow.
fn render(context: &Context) -> Result<Made<Vec<[f32; 3]>>> {
    let mut renderer = Renderer::new(context)?;
    renderer.upload(&start())?;
    Ok((picture(&mut renderer)?, false))
}

fn picture(renderer: &mut Renderer) -> Result<Vec<[f32; 3]>> {
    renderer.set_instance_capacity(3);
    Ok(renderer.render(&camera(&small_view([40, 30])), &RenderSettings::default())?.color)
}

/// Densifies after the second iteration, resets opacities after the third.
fn settings() -> TrainSettings {
    TrainSettings {
        iterations: 100,
        densify_from_iter: 1,
        densification_interval: 2,
        densify_until_iter: 4,
        opacity_reset_interval: 3,
        densify_grad_threshold: 1e-6,
        ..TrainSettings::reference()
    }
}

const STEPS: u32 = 4;

fn trainer(context: &Context) -> Result<Trainer> {
    Run::new(context, views(2, 5), settings()).try_begin()
}

fn train(context: &Context) -> Result<Made<Gaussians>> {
    let mut trainer = trainer(context)?;
    let mut limited = false;
    for _ in 0..STEPS {
        limited |= trainer.step()?.densified.is_some_and(|d| d.limited);
    }
    Ok((trainer.gaussians()?, limited))
}

fn is_of(fault: Fault, error: &Error) -> bool {
    let text = error.to_string();
    let is_line = !text.contains('\n') && text.contains("failed");
    assert!(is_line || matches!(error, Error::Timeout { .. }), "{text}");
    match fault {
        Fault::Allocation => text.contains("OUT_OF_DEVICE_MEMORY") && text.contains("of arena"),
        Fault::Object | Fault::WaitMemory => text.contains("OUT_OF_HOST_MEMORY"),
        Fault::SubmitLost | Fault::WaitLost => matches!(error, Error::DeviceLost { .. }),
        Fault::Timeout => matches!(error, Error::Timeout { .. }),
        Fault::Panic => false,
    }
}

/// Calls of a kind to fail: the first and the last one of every function, and one in `stride`.
fn chosen(fault: Fault, faults: &Faults, stride: usize) -> Vec<u64> {
    let mut chosen: Vec<u64> = (0..faults.calls(fault)).step_by(stride).collect();
    let functions = if fault == Fault::Object { faults.objects() } else { Vec::new() };
    let is_at_an_end = |&index: &usize| {
        let (before, name, after) = (&functions[..index], &functions[index], &functions[index + 1..]);
        !before.contains(name) || !after.contains(name)
    };
    chosen.extend((0..functions.len()).filter(is_at_an_end).map(|index| index as u64));
    chosen.sort_unstable();
    chosen.dedup();
    chosen
}

/// Makes each call fail on the same device: failed objects are dropped, and the next run works as usual. Returns the
/// functions called.
fn check_again_and_again<T: PartialEq>(
    name: &str,
    fault: Fault,
    stride: usize,
    run: fn(&Context) -> Result<Made<T>>,
) -> Vec<&'static str> {
    let (context, faults) = device();
    let whole = run(&context).expect("no fault yet");
    faults.disarm();
    run(&context).expect("no fault yet");
    assert!(faults.calls(fault) > 2);
    let (indices, functions) = (chosen(fault, &faults, stride), faults.objects());
    for (number, index) in (1..).zip(indices) {
        faults.arm(fault, index);
        match run(&context) {
            Ok(result) => assert!(result.1 || result == whole, "{name}: wrong after {fault:?} {index}"),
            Err(error) => assert!(is_of(fault, &error), "{name}, {fault:?} {index}: {error}"),
        }
        assert_eq!(faults.injected(), number, "{name}: {fault:?} {index} was not reached");
        let function = functions.get(index as usize).filter(|_| fault == Fault::Object);
        assert_nothing_allocated(&context, &format!("{name}, {fault:?} {index}, {function:?}"));
        assert!(!context.is_lost());
    }
    faults.disarm();
    assert!(run(&context).expect("works again") == whole, "{name}: another result afterwards");
    close(context);
    functions
}

#[test]
fn faults_of_allocations() {
    check_again_and_again("render", Fault::Allocation, 1, render);
    check_again_and_again("train", Fault::Allocation, stride(3), train);
}

#[test]
fn faults_of_other_objects() {
    let functions = check_again_and_again("render", Fault::Object, stride(STRIDE), render);
    let views = crate::common::context().limits().prefers_texels().then_some("create_buffer_view");
    for function in ["begin_command_buffer", "end_command_buffer", "queue_submit2"].into_iter().chain(views) {
        assert!(functions.contains(&function), "{function} is not injected");
    }
    check_again_and_again("train", Fault::Object, stride(3 * STRIDE), train);
}

/// Without push descriptors, recording allocates descriptor sets.
#[test]
fn faults_of_descriptor_sets() {
    let device = || device_with(ContextOptions { push_descriptors: false, ..options() });
    let (context, faults) = device();
    faults.disarm();
    let whole = render(&context).expect("no fault yet");
    let functions = faults.objects();
    close(context);
    for function in ["create_descriptor_pool", "allocate_descriptor_sets"] {
        let index = functions.iter().position(|name| *name == function).expect(function);
        // Pools are kept: only a device's first run creates them.
        let (context, faults) = device();
        faults.arm(Fault::Object, index as u64);
        let error = render(&context).expect_err(function);
        assert!(is_of(Fault::Object, &error), "{function}: {error}");
        assert_eq!(faults.objects()[index], function);
        assert!(render(&context).expect("works again") == whole, "{function}: another picture");
        close(context);
    }
}

/// A lost device stays lost: all remaining objects report it, and can be dropped.
fn check_lost<T>(name: &str, fault: Fault, stride: usize, run: fn(&Context) -> Result<T>) {
    let (context, faults) = device();
    run(&context).map(drop).expect("no fault yet");
    let calls = faults.calls(fault);
    close(context);
    for index in (0..calls).step_by(stride) {
        let (context, faults) = device();
        faults.arm(fault, index);
        let error = run(&context).map(drop).expect_err("lost");
        assert!(is_of(fault, &error), "{name}, {fault:?} {index}: {error}");
        assert!(context.is_lost());
        let error = run(&context).map(drop).expect_err("lost for good");
        assert!(matches!(error, Error::DeviceLost { .. }), "{error}");
        close(context);
    }
}

#[test]
fn faults_of_lost_devices() {
    check_lost("render", Fault::SubmitLost, stride(2), render);
    check_lost("render", Fault::WaitLost, stride(3), render);
    check_lost("train", Fault::SubmitLost, stride(7), train);
    check_lost("train", Fault::WaitLost, stride(9), train);
}

/// Repeats an attempt until it succeeds. Returns the number of failures.
fn insist<T>(mut attempt: impl FnMut() -> Result<T>) -> (T, u32) {
    for failures in 0..1000 {
        if let Ok(result) = attempt() {
            return (result, failures);
        }
        // The thread that waits for the timed-out submission may need a moment.
        std::thread::sleep(Duration::from_millis(10));
    }
    panic!("does not work again")
}

/// The renderer and the trainer that got the failure continue, with the same bits as without it.
#[test]
fn faults_leave_renderer_and_trainer_usable() {
    let (context, faults) = device();
    let mut renderer = loaded(&context, &start());
    faults.disarm();
    let whole = picture(&mut renderer).expect("no fault yet");
    for fault in [Fault::Allocation, Fault::Object, Fault::Timeout, Fault::WaitMemory] {
        renderer.set_instance_capacity(3);
        faults.disarm();
        picture(&mut renderer).expect("no fault yet");
        let calls = faults.calls(fault);
        for index in (0..calls).step_by(if fault == Fault::Object { stride(4) } else { 1 }) {
            faults.arm(fault, index);
            let (color, failures) = insist(|| picture(&mut renderer));
            assert!(color == whole, "{fault:?} {index}: another picture");
            let waits = matches!(fault, Fault::Timeout | Fault::WaitMemory);
            assert!(failures > 0 || !waits, "{fault:?} {index} went unnoticed");
        }
    }
    drop(renderer);
    let (whole, _) = train(&context).expect("no fault");
    for fault in [Fault::Allocation, Fault::Object] {
        let mut first = trainer(&context).expect("a trainer");
        faults.disarm();
        insist(|| if first.step()?.iteration == STEPS { Ok(()) } else { Err(Error::Interrupted) });
        let calls = faults.calls(fault);
        drop(first);
        for index in (0..calls).step_by(stride(9)) {
            faults.disarm();
            let mut trainer = trainer(&context).expect("a trainer");
            faults.arm(fault, index);
            let mut limited = false;
            insist(|| {
                let report = trainer.step()?;
                limited |= report.densified.is_some_and(|d| d.limited);
                if report.iteration == STEPS { Ok(()) } else { Err(Error::Interrupted) }
            });
            let same = limited || trainer.gaussians().expect("there") == whole;
            assert!(same, "{fault:?} {index}: other bits");
        }
    }
    faults.disarm();
    close(context);
}

/// A step that timed out may have moved the Gaussians: the trainer reports it, and the device continues.
#[test]
fn faults_of_timeouts_in_training() {
    check_waits(Fault::Timeout, stride(9));
    check_waits(Fault::WaitMemory, stride(13));
}

fn check_waits(fault: Fault, stride: usize) {
    let (context, faults) = device();
    // The first training of a context waits more often, and each one once more at its end.
    let (whole, _) = train(&context).expect("no fault");
    faults.disarm();
    let mut unharmed = trainer(&context).expect("no fault");
    for _ in 0..STEPS {
        unharmed.step().expect("no fault");
    }
    unharmed.gaussians().expect("no fault");
    let calls = faults.calls(fault);
    drop(unharmed);
    for index in (0..calls).step_by(stride) {
        faults.disarm();
        faults.arm(fault, index);
        let mut trainer = match trainer(&context) {
            Ok(trainer) => trainer,
            Err(error) => {
                assert!(is_of(fault, &error), "{error}");
                continue;
            }
        };
        let Some(error) = (0..STEPS).find_map(|_| trainer.step().err()) else {
            // The remaining waits belong to reading the result, which changes nothing.
            let error = trainer.gaussians().expect_err("what else waits");
            assert!(is_of(fault, &error), "{error}");
            assert!(insist(|| trainer.gaussians()).0 == whole, "other bits");
            continue;
        };
        assert!(is_of(fault, &error), "{error}");
        let error = refusal(trainer.step());
        assert_says(&error, &["checkpoint"]);
        assert_eq!(refusal(trainer.checkpoint()), error);
        assert_eq!(refusal(trainer.gaussians()), error);
        assert_eq!(refusal(trainer.render(&views(1, 5)[0].camera, &trainer.render_settings())), error);
    }
    faults.disarm();
    assert!(insist(|| train(&context)).0.0 == whole, "other bits");
    close(context);
}

/// Enough Gaussians to outgrow their planes (2800 have a capacity of 4200) in the densification after the second
/// iteration.
fn about_to_grow(context: &Context) -> Trainer {
    let mut many = gaussians(&small_scene(&mut Random::new(42), 2800, 16));
    many.log_scales.iter_mut().flatten().for_each(|s| *s -= 2.5);
    let settings = TrainSettings { densify_grad_threshold: 0.0, sh_degree: 1, ..settings() };
    let mut trainer = Run::new(context, views(2, 5), settings).starting_at(&many).begin();
    trainer.steps(2);
    trainer
}

/// Growing fails in each of its calls, alone and with all that follow. The trainer then grows with the same bits,
/// adds only the Gaussians that fit, or refuses the step and makes it later.
#[test]
fn faults_of_growth() {
    let (context, faults) = device();
    let mut trainer = about_to_grow(&context);
    faults.disarm();
    let grown = trainer.step().expect("a step").densified.expect("due");
    let kinds = [(Fault::Allocation, 1), (Fault::Object, stride(100))];
    let calls = kinds.map(|(fault, stride)| chosen(fault, &faults, stride));
    let whole = trainer.gaussians().expect("there");
    drop(trainer);
    assert!(grown.rows() > 4200 && !grown.limited && calls[0].len() > 5, "{grown:?}, {calls:?}");
    for (fault, indices) in [Fault::Allocation, Fault::Object].into_iter().zip(calls) {
        let (mut same, mut limited, mut refused) = (0, 0, 0);
        let cases = indices.iter().flat_map(|&index| [(index, 1), (index, u64::MAX)]);
        for (index, many) in cases.step_by(stride(if fault == Fault::Object { 9 } else { 3 })) {
            let mut trainer = about_to_grow(&context);
            faults.arm_many(fault, index, many);
            let before = faults.injected();
            let step = trainer.step();
            assert!(faults.injected() > before, "{fault:?} {index} was not reached");
            faults.disarm();
            let densified = match step {
                Ok(report) => report.densified,
                Err(error) => {
                    assert!(is_of(fault, &error), "{fault:?} {index}: {error}");
                    refused += 1;
                    // A densification before the failure is not repeated.
                    trainer.step().expect("tried again").densified
                }
            };
            match densified {
                Some(densified) if densified.limited => {
                    assert!(densified.rows() <= 4200, "{densified:?}");
                    limited += 1;
                }
                _ => {
                    let now = trainer.gaussians().expect("there");
                    let is_whole = now == whole;
                    assert!(is_whole || now.len() <= 4200, "{fault:?} {index}, {many}: other bits");
                    same += u32::from(is_whole);
                }
            }
            trainer.step().expect("it goes on");
            drop(trainer);
            assert_nothing_allocated(&context, "the refusal");
        }
        eprintln!("growth, {fault:?}: {same} the same, {limited} within the planes, {refused} tried again");
        assert!(limited > 0 && same > 0);
    }
    close(context);
}

/// A viewer's picture between two steps panics; later steps have the same bits. With absolute gradients, frames of
/// training have buffers that pictures lack.
#[test]
fn faults_that_panic_in_a_picture_leave_training_as_it_is() {
    let (context, faults) = device();
    let settings =
        TrainSettings { absgrad: true, split: SplitType::LongAxis, ..crate::checkpoints::settings() };
    let camera = views(1, 9)[0].camera;
    let run = |panics: bool| {
        let mut trainer =
            Trainer::new(&context, views(3, 9), &start(), EXTENT, settings.clone()).expect("a trainer");
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

/// A device builds each pipeline once. After a failed build, the next run on the device builds it.
#[test]
fn faults_of_pipelines() {
    const OF_PIPELINES: [&str; 4] = [
        "create_shader_module",
        "create_compute_pipelines",
        "create_pipeline_layout",
        "create_descriptor_set_layout",
    ];
    let is_of_pipelines = |function: &&str| OF_PIPELINES.contains(function);
    let (context, faults) = device();
    let whole = render(&context).expect("no fault yet");
    let calls = faults.objects();
    faults.disarm();
    assert!(render(&context).expect("no fault") == whole);
    assert!(!faults.objects().iter().any(is_of_pipelines), "built twice");
    close(context);
    for function in OF_PIPELINES {
        let places: Vec<usize> = (0..calls.len()).filter(|&place| calls[place] == function).collect();
        for place in [places[0], places[places.len() / 2]] {
            let (context, faults) = device();
            faults.arm(Fault::Object, place as u64);
            let error = render(&context).map(|_| ()).expect_err("a fault");
            assert!(is_of(Fault::Object, &error), "{function} {place}: {error}");
            assert_eq!(faults.objects().last(), Some(&function));
            faults.disarm();
            assert!(render(&context).expect("works again") == whole, "{function} {place}");
            close(context);
        }
    }
}

/// Each allocation of a pruning fails: the pruning is skipped, and training continues.
#[test]
fn faults_of_prunings() {
    let (context, faults) = device();
    let settings = TrainSettings {
        iterations: 1000,
        sh_degree: 1,
        scale_schedule: false,
        densify_from_iter: 900,
        densify_until_iter: 990,
        opacity_reset_interval: 130,
        cap_max: 1000,
        ..TrainSettings::of_strategy(StrategyType::Budget)
    };
    let mut trainer =
        Trainer::new(&context, views(2, 5), &start(), EXTENT, settings.clone()).expect("a trainer");
    (0..430).for_each(|_| drop(trainer.step().expect("a step")));
    // The pruning is due next.
    let before = trainer.checkpoint().expect("a checkpoint");
    drop(trainer);
    let resumed =
        || Trainer::resume(&context, views(2, 5), EXTENT, settings.clone(), &before).expect("resumed");
    let mut trainer = resumed();
    faults.disarm();
    let pruned = trainer.step().expect("a step").densified.expect("due");
    assert!(pruned.kept < pruned.before && !pruned.limited, "{pruned:?}");
    let calls = chosen(Fault::Allocation, &faults, 1);
    drop(trainer);
    let mut left_out = 0;
    for (index, many) in calls.into_iter().flat_map(|index| [(index, 1), (index, 3)]) {
        let mut trainer = resumed();
        faults.arm_many(Fault::Allocation, index, many);
        let step = trainer.step();
        faults.disarm();
        // The step itself allocates as well.
        if let Ok(report) = step {
            let densified = report.densified.expect("due");
            assert!(densified == pruned || densified.limited, "{densified:?}");
            assert!(!densified.limited || densified.rows() == densified.before, "{densified:?}");
            left_out += u32::from(densified.limited);
        }
        trainer.step().expect("it goes on");
        drop(trainer);
        assert_nothing_allocated(&context, "prunings");
    }
    // One allocation for the order of opacities, one for the decisions.
    assert!(left_out >= 2, "{left_out}");
    close(context);
}
