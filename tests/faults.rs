//! Every Vulkan call that may fail is made to fail once. The result is a typed error, no panic, no leak. Affected
//! objects work again or report that they do not.

mod panics;
mod pipelines;
mod prunings;

use std::time::Duration;

use ashsplat::trainer::Trainer;
use ashsplat::vk::{Context, ContextOptions, Fault, Faults};
use ashsplat::{Error, Gaussians, RenderSettings, Renderer, Result, TrainSettings};

use crate::checkpoints::{start, views};
use crate::common::engine::{camera, gaussians};
use crate::common::options;
use crate::common::scenes::{Random, small_scene, small_view};

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
    // A thread waits for a submission that timed out.
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
        ..TrainSettings::default()
    }
}

const STEPS: u32 = 4;

fn trainer(context: &Context) -> Result<Trainer> {
    Trainer::new(context, views(2, 5), &start(), 5.0, settings())
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
    assert!(
        !text.contains('\n') && text.contains("failed") || matches!(error, Error::Timeout { .. }),
        "{text}"
    );
    match fault {
        Fault::Allocation => text.contains("OUT_OF_DEVICE_MEMORY") && text.contains("of arena"),
        Fault::Object | Fault::WaitMemory => text.contains("OUT_OF_HOST_MEMORY"),
        Fault::SubmitLost | Fault::WaitLost => matches!(error, Error::DeviceLost { .. }),
        Fault::Timeout => matches!(error, Error::Timeout { .. }),
        Fault::Panic => false,
    }
}

/// Outcomes of a run's calls, each made to fail in turn.
#[derive(Debug, Default)]
struct Matrix {
    calls: u64,
    injected: u64,
    refused: u64,
    survived: u64,
}

impl Matrix {
    fn count(&mut self, survived: bool) {
        self.injected += 1;
        self.survived += u64::from(survived);
        self.refused += u64::from(!survived);
    }
}

/// Calls of a kind to fail: the first and the last one of every function, and one in `stride`.
fn chosen(fault: Fault, faults: &Faults, stride: usize) -> Vec<u64> {
    let mut chosen: Vec<u64> = (0..faults.calls(fault)).step_by(stride).collect();
    if fault == Fault::Object {
        let functions = faults.objects();
        for (index, name) in functions.iter().enumerate() {
            let (before, after) = (&functions[..index], &functions[index + 1..]);
            if !before.contains(name) || !after.contains(name) {
                chosen.push(index as u64);
            }
        }
    }
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
    let mut matrix = Matrix { calls: faults.calls(fault), ..Matrix::default() };
    assert!(matrix.calls > 2, "{matrix:?}");
    let (indices, functions) = (chosen(fault, &faults, stride), faults.objects());
    for index in indices {
        faults.arm(fault, index);
        match run(&context) {
            Ok(result) => {
                let same = result.1 || result == whole;
                assert!(same, "{name}: a wrong result after {fault:?} {index}");
                matrix.count(true);
            }
            Err(error) => {
                assert!(is_of(fault, &error), "{name}, {fault:?} {index}: {error}");
                matrix.count(false);
            }
        }
        assert_eq!(faults.injected(), matrix.injected, "{name}: {fault:?} {index} was not reached");
        let function = functions.get(index as usize).filter(|_| fault == Fault::Object);
        assert_nothing_allocated(&context, &format!("{name}, {fault:?} {index}, {function:?}"));
        assert!(!context.is_lost());
    }
    faults.disarm();
    assert!(run(&context).expect("works again") == whole, "{name}: another result afterwards");
    eprintln!("{name}, {fault:?}: {matrix:?}");
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
    let mut matrix = Matrix { calls: faults.calls(fault), ..Matrix::default() };
    close(context);
    for index in (0..matrix.calls).step_by(stride) {
        let (context, faults) = device();
        faults.arm(fault, index);
        let error = run(&context).map(drop).expect_err("lost");
        assert!(is_of(fault, &error), "{name}, {fault:?} {index}: {error}");
        assert!(context.is_lost());
        let error = run(&context).map(drop).expect_err("lost for good");
        assert!(matches!(error, Error::DeviceLost { .. }), "{error}");
        matrix.count(false);
        close(context);
    }
    eprintln!("{name}, {fault:?}: {matrix:?}");
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
    let mut renderer = Renderer::new(&context).expect("a renderer");
    renderer.upload(&start()).expect("upload");
    faults.disarm();
    let whole = picture(&mut renderer).expect("no fault yet");
    for fault in [Fault::Allocation, Fault::Object, Fault::Timeout, Fault::WaitMemory] {
        renderer.set_instance_capacity(3);
        faults.disarm();
        picture(&mut renderer).expect("no fault yet");
        let mut matrix = Matrix { calls: faults.calls(fault), ..Matrix::default() };
        for index in (0..matrix.calls).step_by(if fault == Fault::Object { stride(4) } else { 1 }) {
            faults.arm(fault, index);
            let (color, failures) = insist(|| picture(&mut renderer));
            assert!(color == whole, "{fault:?} {index}: another picture");
            let waits = matches!(fault, Fault::Timeout | Fault::WaitMemory);
            assert!(failures > 0 || !waits, "{fault:?} {index} went unnoticed");
            matrix.count(failures == 0);
        }
        eprintln!("the same renderer, {fault:?}: {matrix:?}");
    }
    drop(renderer);
    let (whole, _) = train(&context).expect("no fault");
    for fault in [Fault::Allocation, Fault::Object] {
        let mut first = trainer(&context).expect("a trainer");
        faults.disarm();
        insist(|| if first.step()?.iteration == STEPS { Ok(()) } else { Err(Error::Interrupted) });
        let mut matrix = Matrix { calls: faults.calls(fault), ..Matrix::default() };
        drop(first);
        for index in (0..matrix.calls).step_by(stride(9)) {
            faults.disarm();
            let mut trainer = trainer(&context).expect("a trainer");
            faults.arm(fault, index);
            let mut limited = false;
            let (_, unfinished) = insist(|| {
                let report = trainer.step()?;
                limited |= report.densified.is_some_and(|d| d.limited);
                if report.iteration == STEPS { Ok(()) } else { Err(Error::Interrupted) }
            });
            let same = limited || trainer.gaussians().expect("there") == whole;
            assert!(same, "{fault:?} {index}: other bits");
            matrix.count(unfinished < STEPS);
        }
        eprintln!("the same trainer, {fault:?}: {matrix:?}");
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
    let (whole, _) = train(&context).expect("no fault");
    let mut matrix = Matrix { calls: faults.calls(fault), ..Matrix::default() };
    for index in (0..matrix.calls).step_by(stride) {
        faults.disarm();
        faults.arm(fault, index);
        match trainer(&context) {
            Err(error) => assert!(is_of(fault, &error), "{error}"),
            Ok(mut trainer) => {
                match (0..STEPS).find_map(|_| trainer.step().err()) {
                    Some(error) => {
                        assert!(is_of(fault, &error), "{error}");
                        let error = trainer.step().expect_err("unknown state").to_string();
                        assert!(error.contains("checkpoint"), "{error}");
                        let handed_out = [
                            trainer.checkpoint().map(drop),
                            trainer.gaussians().map(drop),
                            trainer.render(&views(1, 5)[0].camera, &trainer.render_settings()).map(drop),
                        ];
                        for refused in handed_out {
                            let refused = refused.expect_err("the state is unknown").to_string();
                            assert_eq!(refused, error);
                        }
                    }
                    // The remaining waits belong to reading the result, which changes nothing.
                    None => {
                        let error = trainer.gaussians().expect_err("what else waits");
                        assert!(is_of(fault, &error), "{error}");
                        assert!(insist(|| trainer.gaussians()).0 == whole, "other bits");
                    }
                }
            }
        }
        matrix.count(false);
    }
    eprintln!("train, {fault:?}: {matrix:?}");
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
    let mut trainer = Trainer::new(context, views(2, 5), &many, 5.0, settings).expect("a trainer");
    (0..2).for_each(|_| drop(trainer.step().expect("a step")));
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
        eprintln!(
            "growth, {fault:?}: {same} with the same bits, {limited} within the planes, {refused} tried again"
        );
        assert!(limited > 0 && same > 0);
    }
    close(context);
}
