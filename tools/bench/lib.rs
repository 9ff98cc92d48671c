//! `ashsplat bench`: measures every kernel beside the device's own copy bandwidth, and the cost of quality.

// Used by the program alone.
#![allow(missing_docs)]

#[macro_use]
extern crate ashsplat_program;

mod arguments;
mod compare;
mod compiled;
mod forms;
mod frames;
mod kernels;
mod machine;
mod measure;
mod primitives;
pub mod profile;
mod samples;
mod schema;
mod sizes;
mod suite;
mod synthetic;
mod table;
mod tasks;
mod traffic;
mod training;
mod workload;

use arguments::{AllArguments, FrameArguments, OutputArguments, PrimitiveArguments, TrainArguments};
use ashsplat::Result;
use ashsplat::vk::Context;
use clap::{Args, Subcommand};
use measure::{Iterations, Yardsticks};
use schema::{Report, Run, Settings};
use tasks::Task;

/// Measure: every kernel's time, workgroups and bytes, beside what this device copies per second.
///
/// The result file (--json) follows the schema ashsplat-bench/1, described in tools/bench.md. Bytes are those of a
/// kernel's inputs and outputs, each element once, so that "copy" says how far a kernel is from the speed of a plain
/// copy of them on this device.
#[derive(Args)]
pub struct Arguments {
    #[command(subcommand)]
    what: Benchmark,
}

#[derive(Subcommand)]
enum Benchmark {
    /// The prefix sum alone
    Scan(PrimitiveArguments),
    /// The radix sort alone
    Sort(PrimitiveArguments),
    /// A frame
    Render(FrameArguments),
    /// A training step
    TrainStep(FrameArguments),
    /// Training of a data set from its points, as `train` does it
    Train(TrainArguments),
    /// Everything: the primitives at two sizes, two synthetic frames, a step; also --scene and --dataset
    All(AllArguments),
    /// Compare training recipes on scenes: held-out PSNR, gain or loss of each scene, time to a PSNR
    Suite(suite::Arguments),
}

pub fn run(arguments: &Arguments) -> Result<()> {
    let frames = |a: &FrameArguments, what| {
        let plan = (a.iterations.get(), a.scene.synthetic.seed());
        measure_all(&a.output, plan, |_| tasks::of_frames(a, what))
    };
    let primitive = |a: &PrimitiveArguments, task: fn(u32, Iterations) -> Task, usual| {
        let iterations = a.iterations.get();
        let task = task(a.elements.unwrap_or(usual), iterations);
        measure_all(&a.output, (iterations, a.seed), |_| Ok(vec![task]))
    };
    match &arguments.what {
        Benchmark::Scan(a) => primitive(a, Task::Scan, tasks::VALUES_PER_PAIR * tasks::PAIRS),
        Benchmark::Sort(a) => primitive(a, Task::Sort, tasks::PAIRS),
        Benchmark::Render(a) => frames(a, frames::IterationKind::Render),
        Benchmark::TrainStep(a) => frames(a, frames::IterationKind::TrainStep),
        Benchmark::Train(a) => {
            measure_all(&a.output, (training::ITERATIONS, a.seed), |_| tasks::of_training(a))
        }
        Benchmark::All(a) => {
            let plan = (a.iterations.get(), a.synthetic.seed());
            measure_all(&a.output, plan, |context| tasks::of_all(a, context.limits().tuning.is_slow))
        }
        Benchmark::Suite(a) => suite::run(a),
    }
}

fn measure_all(
    output: &OutputArguments,
    (iterations, seed): (Iterations, u64),
    tasks: impl FnOnce(&Context) -> Result<Vec<Task>>,
) -> Result<()> {
    output.check()?;
    // A missing device is reported before the scenes, which may have many photos, are read.
    let context = output.context()?;
    let tasks = tasks(&context)?;
    let yardsticks = Yardsticks::measure(&context)?;
    let mut runs = Vec::new();
    let mut counter = samples::Counter::new(&output.device);
    for task in tasks {
        let mut results = task.run(&context, seed, yardsticks.copy.as_ref())?;
        let samples = counter.count(&task)?;
        for (run, samples) in results.iter_mut().zip(samples) {
            samples::enter(run, samples, context.limits(), yardsticks.arithmetic.as_ref());
        }
        runs.extend(results);
    }
    name_apart(&mut runs);
    let report = assemble(&context, iterations, seed, (yardsticks, runs));
    output.write(&report)?;
    if !output.quiet {
        outln!("{}", table::render(&report).trim_end());
    }
    output.device.report_validation(&context);
    counter.report_validation();
    Ok(())
}

/// Appends the size to the names of runs that repeat an earlier name.
fn name_apart(runs: &mut [Run]) {
    let mut seen: Vec<String> = Vec::new();
    for run in runs {
        if seen.contains(&run.name) {
            let w = &run.workload;
            let size = match (w.elements, w.gaussians, w.width, w.height) {
                (Some(elements), ..) => elements.to_string(),
                (_, Some(gaussians), Some(width), Some(height)) => format!("{gaussians}@{width}x{height}"),
                _ => String::new(),
            };
            run.name = format!("{}-{size}", run.name);
        }
        let mut name = run.name.clone();
        while seen.contains(&name) {
            name.push('\'');
        }
        run.name.clone_from(&name);
        seen.push(name);
    }
}

/// Makes the report of runs measured on a context.
fn assemble(
    context: &Context,
    iterations: Iterations,
    seed: u64,
    (yardsticks, runs): (Yardsticks, Vec<Run>),
) -> Report {
    Report {
        schema: schema::SCHEMA.to_owned(),
        program: machine::program(),
        host: machine::host(),
        device: machine::device(context),
        environment: machine::environment(),
        settings: Settings {
            iterations: iterations.measured,
            warmup: iterations.warmup,
            seed,
            clock: if context.has_timestamps() { "timestamps" } else { "host" }.to_owned(),
        },
        copy_bandwidth: yardsticks.copy,
        arithmetic: yardsticks.arithmetic,
        runs,
    }
}
