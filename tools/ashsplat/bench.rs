//! `ashsplat bench`: the time of every kernel, against the device's own copy bandwidth.

pub mod compare;
mod cpu_sorts;
pub mod frames;
pub mod machine;
pub mod measure;
pub mod plot;
mod primitives;
mod scaling;
pub mod schema;
mod synthetic;
pub mod table;
mod tasks;
pub mod traffic;
mod training;
pub mod workload;

use crate::args::DeviceArguments;
use crate::output;
use ashsplat::vk::Context;
use ashsplat::{Error, Result};
use clap::{Args, Subcommand};
use measure::{Iterations, Yardsticks};
use schema::{Report, Run, Settings};
use std::path::PathBuf;
use tasks::Task;
use workload::SceneArguments;

/// Measure: every kernel's time, workgroups and bytes, beside what this device copies per second.
///
/// The result file (--json) follows the schema ashsplat-bench/1, described in tools/bench.md. Bytes are those of a
/// kernel's inputs and outputs, each element once, so that "copy" says how far a kernel is from the speed of a plain
/// copy of them on this device.
#[derive(Args)]
pub struct Arguments {
    #[command(subcommand)]
    what: What,
}

#[derive(Subcommand)]
enum What {
    /// The prefix sum alone
    Scan(RunArguments),
    /// The radix sort alone, beside the processor's
    Sort(RunArguments),
    /// A frame
    Render(RunArguments),
    /// A training step
    TrainStep(RunArguments),
    /// Training of a data set from its points, as `train` does it
    Train(RunArguments),
    /// Everything: the primitives at two sizes, two synthetic frames, a step; --scene and --dataset besides
    All(RunArguments),
    /// Two result files, kernel by kernel
    Compare(CompareArguments),
    /// How each stage grows with the Gaussians and the pixels
    Scaling(scaling::Arguments),
}

/// What every measurement takes.
#[derive(Args)]
pub struct RunArguments {
    /// Pairs of the sort; the scan takes four times as many values
    #[arg(long, value_name = "N", default_value_t = 1 << 22, value_parser = clap::value_parser!(u32).range(1..=1 << 28))]
    elements: u32,
    #[command(flatten)]
    pub scene: SceneArguments,
    /// Training: where its measurements end; each covers a hundred iterations
    #[arg(long, value_name = "N,N,...", value_delimiter = ',', default_values_t = [100])]
    windows: Vec<u32>,
    /// More synthetic frames in `all`: Gaussians and size of each
    #[arg(long, value_name = "N@WxH,...", value_delimiter = ',', default_values_t = [tasks::FrameSize::LARGE])]
    frames: Vec<tasks::FrameSize>,
    /// Measured iterations of each workload
    #[arg(long, value_name = "N", default_value_t = 15, value_parser = clap::value_parser!(u32).range(1..))]
    iterations: u32,
    /// Iterations before them that do not count
    #[arg(long, value_name = "N", default_value_t = 3)]
    warmup: u32,
    /// Write the result here (JSON)
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Write one line per kernel here (CSV)
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    /// Do not time kernels, as on a device without timestamps: host times only
    #[arg(long)]
    host_clock: bool,
    #[command(flatten)]
    pub device: DeviceArguments,
    /// Print no table
    #[arg(long)]
    quiet: bool,
}

/// Which files, and when their difference is a failure.
#[derive(Args)]
struct CompareArguments {
    /// The result to compare with
    a: PathBuf,
    /// The result to judge
    b: PathBuf,
    /// Fail where a kernel of B takes more than X times as long as in A, beyond the spread of both
    #[arg(long, value_name = "X")]
    fail_above: Option<f64>,
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> Result<()> {
    match &arguments.what {
        What::Scan(run) => measure_all(run, |run, _| Ok(vec![Task::Scan(run.values())])),
        What::Sort(run) => measure_all(run, |run, _| Ok(vec![Task::Sort(run.elements, run.iterations())])),
        What::Render(run) => measure_all(run, |run, _| tasks::of_frames(run, false)),
        What::TrainStep(run) => measure_all(run, |run, _| tasks::of_frames(run, true)),
        What::Train(run) => measure_all(run, |run, _| tasks::of_training(run)),
        What::All(run) => measure_all(run, |run, context| tasks::of_all(run, context.limits().is_cpu)),
        What::Compare(files) => compare_files(files),
        What::Scaling(sweep) => scaling::run(sweep),
    }
}

fn compare_files(files: &CompareArguments) -> Result<()> {
    if let Some(limit) = files.fail_above
        && !(limit.is_finite() && limit > 0.0)
    {
        return Err(Error::argument(
            "--fail-above",
            format!("is {limit}, must be a positive ratio, say 1.15"),
        ));
    }
    let (a, b) = (compare::read(&files.a)?, compare::read(&files.b)?);
    let lines = compare::compare(&a, &b)?;
    for (name, report) in [("A", &a), ("B", &b)] {
        let commit = report.program.commit.as_deref().unwrap_or("no checkout");
        say!(
            "{name}: {}, {}, ashsplat {} ({commit}, {})",
            report.device.name,
            report.device.driver,
            report.program.version,
            report.program.build
        );
    }
    say!("{}", compare::table(&lines));
    let unpaired = compare::unpaired(&a, &b);
    unpaired.iter().for_each(|kernel| say!("{kernel}"));
    let Some(limit) = files.fail_above else { return Ok(()) };
    if !unpaired.is_empty() {
        return Err(Error::argument("kernels that cannot be compared", unpaired.join(", ")));
    }
    compare::check(&lines, limit)
}

fn measure_all(
    arguments: &RunArguments,
    tasks: impl FnOnce(&RunArguments, &Context) -> Result<Vec<Task>>,
) -> Result<()> {
    // Before the scenes, which may have many photos: a missing device is reported at once.
    let context = arguments.context()?;
    let tasks = tasks(arguments, &context)?;
    let yardsticks = Yardsticks::measure(&context)?;
    let mut runs = Vec::new();
    for task in tasks {
        runs.extend(task.run(&context, arguments, yardsticks.copy.as_ref())?);
    }
    name_apart(&mut runs);
    let report = assemble(&context, arguments.iterations(), arguments.scene.seed, (yardsticks, runs));
    arguments.write(&report)?;
    if !arguments.quiet {
        say!("{}", table::render(&report).trim_end());
    }
    arguments.device.report_validation(&context);
    Ok(())
}

/// Where several runs have the same name, all but the first get their size behind it.
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

impl RunArguments {
    /// Values of a scan, which takes so little time that fewer would be lost in the cost of timing them.
    fn values(&self) -> u32 {
        self.elements.saturating_mul(4).min(1 << 28)
    }

    fn iterations(&self) -> Iterations {
        Iterations { measured: self.iterations, warmup: self.warmup, timed: true }
    }

    fn context(&self) -> Result<Context> {
        self.device.context_with(|options| options.timestamps = !self.host_clock)
    }

    fn write(&self, report: &Report) -> Result<()> {
        if let Some(path) = &self.json {
            output::write_json(path, report)?;
        }
        if let Some(path) = &self.csv {
            output::write_text(path, &table::csv(report))?;
        }
        Ok(())
    }
}

/// A report of runs that were measured on a context.
pub fn assemble(
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
