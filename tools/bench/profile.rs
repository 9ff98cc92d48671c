//! `ashsplat profile`: profiles one frame or one training step.

mod ab;
mod compiled;
mod spec;
mod trace;
mod watch;

use crate::forms::FormArguments;
use crate::frames::{IterationKind, Plan, PlannedWork};
use crate::measure::{Iterations, Yardsticks};
use crate::schema::KernelResult;
use crate::workload::SceneArguments;
use crate::{assemble, frames, table};
use ashsplat::vk::{Context, Profile, SpecOverride, is_kernel_of};
use ashsplat::{Error, Result};
use ashsplat_program::args::DeviceArguments;
use ashsplat_program::output;
use clap::Args;
use std::path::PathBuf;
use std::rc::Rc;

/// Profile one frame or one training step, kernel by kernel.
///
/// Without further options, a table. Settings of shaders are tried with --spec and --ab; with the cargo feature
/// hot-reload, --watch compiles edited shaders again while it runs.
#[derive(Args)]
pub struct Arguments {
    /// What to profile [default: render; with --static both]
    #[arg(value_enum)]
    what: Option<IterationKind>,
    #[command(flatten)]
    scene: SceneArguments,
    #[command(flatten)]
    form: FormArguments,
    /// Measured iterations [default: 20, with --watch 7]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    frames: Option<u32>,
    /// Iterations before them that do not count [default: 3, with --watch 1]
    #[arg(long, value_name = "N")]
    warmup: Option<u32>,
    /// Show only this kernel, "sort/sort_downsweep", or those of this folder, "sort"
    #[arg(long, value_name = "NAME")]
    kernel: Option<String>,
    /// Write a trace here that Perfetto (ui.perfetto.dev) and chrome://tracing open
    #[arg(long, value_name = "FILE")]
    trace: Option<PathBuf>,
    /// Another value for a specialization constant, for one kernel, a folder of kernels or all; may be repeated
    #[arg(long, value_name = "[KERNEL.]NAME=VALUE")]
    spec: Vec<String>,
    /// Time two settings in turn: each a list of settings as for --spec, separated by commas; "-" is none
    #[arg(long, num_args = 2, value_names = ["A", "B"], allow_hyphen_values = true, conflicts_with_all = ["trace", "watch"])]
    ab: Option<Vec<String>>,
    #[command(flatten)]
    compiled: compiled::StaticArguments,
    /// Compile edited shaders again while running, and show what changed (feature hot-reload); Ctrl-C ends it
    #[arg(long, conflicts_with_all = ["trace", "kernel"])]
    watch: bool,
    /// Folder of the shaders for --watch and for kernels that differ from the program's own (feature hot-reload)
    #[arg(long, value_name = "DIR")]
    glsl: Option<PathBuf>,
    /// End --watch after N seconds
    #[arg(long, value_name = "SECONDS", requires = "watch")]
    watch_for: Option<f64>,
    /// Pass on what shaders print with debugPrintfEXT (needs the Khronos validation layer)
    #[arg(long)]
    printf: bool,
    /// Mark one iteration as a capture: for `renderdoccmd capture ashsplat profile --capture`
    #[arg(long, conflicts_with_all = ["trace", "watch", "ab", "frames", "kernel"])]
    capture: bool,
    #[command(flatten)]
    device: DeviceArguments,
}

impl Arguments {
    const FRAMES: u32 = 20;
    /// Default number of iterations before the measured ones.
    const WARMUP: u32 = 3;

    fn what(&self) -> IterationKind {
        self.what.unwrap_or(IterationKind::Render)
    }

    fn frames(&self) -> u32 {
        self.frames.unwrap_or(Self::FRAMES)
    }

    fn warmup(&self) -> u32 {
        self.warmup.unwrap_or(Self::WARMUP)
    }

    fn plan(&self) -> Result<Plan> {
        let what = self.what();
        let scene = Rc::new(self.scene.load(what == IterationKind::TrainStep, &self.device.host)?);
        Ok(Plan { what, scene, form: self.form.get(), reads_back: true, seed: self.scene.synthetic.seed() })
    }

    fn overrides(&self) -> Result<Vec<SpecOverride>> {
        spec::parse_all("--spec", self.spec.iter().map(String::as_str))
    }
}

/// Opens the device with other constants, and with edited shaders if their folder is given.
fn open(arguments: &Arguments, overrides: &[SpecOverride]) -> Result<Context> {
    let context = arguments.device.context_with(|options| {
        options.debug_printf = arguments.printf;
        options.capture = arguments.capture;
        spec::apply(options, overrides);
    })?;
    if let Some(glsl) = &arguments.glsl {
        watch::take_over(&context, glsl)?;
    }
    Ok(context)
}

pub fn run(arguments: &Arguments) -> Result<()> {
    let overrides = arguments.overrides()?;
    check_kernel(arguments.kernel.as_deref())?;
    if arguments.compiled.is_static {
        return compiled::run(arguments);
    }
    output::check(&[("--trace", arguments.trace.as_deref())])?;
    if let Some(settings) = &arguments.ab {
        return ab::run(arguments, settings, &arguments.plan()?);
    }
    let context = open(arguments, &overrides)?;
    let plan = arguments.plan()?;
    if arguments.watch {
        return watch::run(arguments, &context, &plan);
    }
    if arguments.capture {
        return capture(arguments, &context, &plan);
    }
    let yardsticks = Yardsticks::measure(&context)?;
    let iterations = Iterations { measured: arguments.frames(), warmup: arguments.warmup(), timed: true };
    let (mut run, measured) = frames::measure(&context, &plan, iterations, yardsticks.copy.as_ref())?;
    if let Some(path) = &arguments.trace {
        output::write_json(path, &trace::trace(context.device_name(), &measured.iterations))?;
    }
    only(arguments.kernel.as_deref(), &mut run.kernels)?;
    if !arguments.spec.is_empty() {
        outln!("with {}", arguments.spec.join(", "));
    }
    let report = assemble(&context, iterations, plan.seed, (yardsticks, vec![run]));
    outln!("{}", table::render(&report).trim_end());
    print_messages(&context);
    arguments.device.report_validation(&context);
    Ok(())
}

/// Marks one iteration for RenderDoc, which without a window finds no frames to capture.
fn capture(arguments: &Arguments, context: &Context, plan: &Plan) -> Result<()> {
    let mut planned = PlannedWork::new(context, plan)?;
    planned.warm_up(arguments.warmup())?;
    context.capture(|| planned.iterate())?;
    outln!("one {} was marked as a capture", arguments.what().name());
    print_messages(context);
    arguments.device.report_validation(context);
    Ok(())
}

/// A profile of a context that records nothing until it is set.
fn silent_profile(context: &Context) -> Profile {
    let profile = context.profile();
    context.set_profile(None);
    profile
}

/// Largest difference of any channel of any pixel; NaN counts as infinite.
fn largest_difference(a: &[[f32; 3]], b: &[[f32; 3]]) -> f32 {
    let differences = a.iter().flatten().zip(b.iter().flatten()).map(|(a, b)| {
        let difference = (a - b).abs();
        if difference.is_nan() { f32::INFINITY } else { difference }
    });
    differences.fold(0.0, f32::max)
}

/// Keeps the requested kernels. Refuses a kernel that did not run.
fn only(name: Option<&str>, kernels: &mut Vec<KernelResult>) -> Result<()> {
    let Some(name) = name else { return Ok(()) };
    let ran: Vec<String> = kernels.iter().map(|k| k.kernel.clone()).collect();
    kernels.retain(|k| is_kernel_of(&k.kernel, name));
    if kernels.is_empty() {
        let problem = format!("did not run here; these did: {}", ran.join(", "));
        return Err(Error::argument(format!("--kernel {name}"), problem));
    }
    Ok(())
}

/// Refuses a kernel or folder that does not exist, and names those that do.
fn check_kernel(name: Option<&str>) -> Result<()> {
    let Some(name) = name else { return Ok(()) };
    let known = spec::kernel_names();
    if known.iter().any(|k| is_kernel_of(k, name)) {
        return Ok(());
    }
    let problem = format!("there is no such kernel or folder; there are: {}", known.join(", "));
    Err(Error::argument(format!("--kernel {name}"), problem))
}

/// Prints the shaders' messages; a repeated line appears once, with its count.
fn print_messages(context: &Context) {
    let mut counted: Vec<(String, usize)> = Vec::new();
    for message in context.printed() {
        match counted.iter_mut().find(|(seen, _)| *seen == message) {
            Some((_, count)) => *count += 1,
            None => counted.push((message, 1)),
        }
    }
    for (message, count) in counted {
        let times = if count == 1 { String::new() } else { format!("   ({count} times)") };
        outln!("printf: {message}{times}");
    }
}
