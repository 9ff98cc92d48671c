//! `bench scaling`: how the time of each stage and kernel grows with the Gaussians and with the pixels.

use super::arguments::{IterationArguments, OutputArguments};
use super::frames::{Plan, What};
use super::measure::Yardsticks;
use super::schema::{KernelResult, Report, Run};
use super::workload::{MOST_GAUSSIANS, SyntheticArguments};
use super::{assemble, frames, table};
use ashsplat::frame::max_trained_gaussians;
use ashsplat::vk::Context;
use ashsplat::{Error, Result};
use ashsplat_program::chart::{Axis, Line, Panel, figure};
use ashsplat_program::output;
use ashsplat_program::progress::thousands;
use clap::{Args, ValueEnum};
use std::path::PathBuf;
use std::rc::Rc;

/// What is swept.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Task {
    /// Frames, as `bench render` measures them
    Frames,
    /// Training steps, as `bench train-step` measures them
    Steps,
}

/// Sweep the number of Gaussians at one resolution, then the resolution at one number of Gaussians, of frames and of
/// training steps, and fit how the time of each stage grows: time ~ count^exponent.
#[derive(Args)]
pub struct Arguments {
    /// What to sweep
    #[arg(long, value_name = "WHAT,...", value_delimiter = ',', value_enum, default_values_t = [Task::Frames, Task::Steps])]
    of: Vec<Task>,
    /// Numbers of Gaussians
    #[arg(long, value_name = "N,N,...", value_delimiter = ',', default_values_t = [10_000, 30_000, 100_000, 300_000, 1_200_000], value_parser = clap::value_parser!(u32).range(1..=MOST_GAUSSIANS))]
    counts: Vec<u32>,
    /// Width of the pictures meanwhile, pixels
    #[arg(long, value_name = "PIXELS", default_value_t = 960, value_parser = clap::value_parser!(u32).range(1..))]
    width: u32,
    /// Widths of the pictures: square to 512, 16:9 above
    #[arg(long, value_name = "N,N,...", value_delimiter = ',', default_values_t = [256, 512, 1024, 1920, 3840], value_parser = clap::value_parser!(u32).range(1..))]
    widths: Vec<u32>,
    /// Gaussians meanwhile
    #[arg(long, value_name = "N", default_value_t = SyntheticArguments::GAUSSIANS, value_parser = clap::value_parser!(u32).range(1..=MOST_GAUSSIANS))]
    gaussians: u32,
    /// SH degree of all
    #[arg(long, value_name = "N", default_value_t = SyntheticArguments::SH_DEGREE, value_parser = clap::value_parser!(u32).range(0..=3))]
    sh_degree: u32,
    /// Seed of the scenes
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
    /// Write the plot here (SVG)
    #[arg(long, value_name = "FILE")]
    plot: Option<PathBuf>,
    #[command(flatten)]
    iterations: IterationArguments,
    #[command(flatten)]
    output: OutputArguments,
}

/// Points of a sweep: its size and its run.
type Sweep = Vec<(f64, Run)>;

/// Runs the command.
pub fn run(arguments: &Arguments) -> Result<()> {
    arguments.output.check(&[("--plot", arguments.plot.as_deref())])?;
    for count in arguments.all_counts() {
        arguments.scene(count, arguments.width).check()?;
    }
    let context = arguments.output.context()?;
    arguments.check_trained(max_trained_gaussians(context.limits()))?;
    let yardsticks = Yardsticks::measure(&context)?;
    let (width, fixed) = (arguments.width, thousands(arguments.gaussians.into()));
    let (mut panels, mut sweeps): (Vec<Panel>, Vec<Sweep>) = (Vec::new(), Vec::new());
    for task in Task::value_variants().iter().copied().filter(|task| arguments.of.contains(task)) {
        let measure = |size| arguments.measure(task, &context, &yardsticks, size);
        let by_count = arguments.counts.iter().map(|&n| Ok((f64::from(n), measure((n, width))?)));
        let by_count = by_count.collect::<Result<Sweep>>()?;
        let pixels = |width: u32| f64::from(width) * f64::from(height_of(width));
        let by_pixels = arguments.widths.iter().map(|&w| Ok((pixels(w), measure((arguments.gaussians, w))?)));
        let by_pixels = by_pixels.collect::<Result<Sweep>>()?;
        let growth = |fixed: String, axis: &str, sweep: &Sweep| {
            let lines = series(task, sweep);
            let points = || lines.iter().flat_map(|line| line.points.iter().copied());
            Panel {
                title: format!("{}, {fixed}", task.plural()),
                along: axis.to_owned(),
                upwards: "milliseconds",
                x: Axis::decades(points().map(|(x, _)| x)),
                y: Axis::decades(points().map(|(_, y)| y)),
                lines,
                levels: Vec::new(),
            }
        };
        panels.push(growth(format!("{width}x{} pixels", height_of(width)), "Gaussians", &by_count));
        panels.push(growth(format!("{fixed} Gaussians"), "pixels", &by_pixels));
        sweeps.extend([by_count, by_pixels]);
    }
    if !arguments.output.quiet {
        for (panel, sweep) in panels.iter().zip(&sweeps) {
            let title =
                format!("{}: milliseconds by {}, and the exponent of their growth", panel.title, panel.along);
            say!("\n{title}\n{}", exponents(&panel.along, &[&panel.lines[..], &kernel_series(sweep)]));
        }
    }
    let mut runs = sweeps.into_iter().flatten().map(|(_, run)| run).collect::<Vec<_>>();
    super::name_apart(&mut runs);
    let report: Report = assemble(&context, arguments.iterations.get(), arguments.seed, (yardsticks, runs));
    arguments.output.write(&report)?;
    if let Some(path) = &arguments.plot {
        let title = format!("Time of each stage on {}, {}", report.device.name, report.device.driver);
        // Zero means that the stage does not run at this size.
        let lines = panels.iter_mut().flat_map(|panel| &mut panel.lines);
        lines.for_each(|line| line.points.retain(|&(x, y)| x > 0.0 && y > 0.0));
        output::write_text(path, &figure(&title, &panels))?;
    }
    arguments.output.device.report_validation(&context);
    Ok(())
}

impl Arguments {
    /// All measured numbers of Gaussians.
    fn all_counts(&self) -> impl Iterator<Item = u32> {
        self.counts.iter().copied().chain([self.gaussians])
    }

    /// Refuses steps of more Gaussians than the device can train, before frames are measured in vain.
    fn check_trained(&self, most: u32) -> Result<()> {
        let largest = self.all_counts().max().unwrap_or(0);
        if largest <= most || !self.of.contains(&Task::Steps) {
            return Ok(());
        }
        let problem = format!(
            "this device trains at most {} (a binding holds the gradients of no more); \
             sweep fewer with --counts and --gaussians, or --of frames alone",
            thousands(most.into())
        );
        Err(Error::argument(format!("{} Gaussians", thousands(largest.into())), problem))
    }

    fn scene(&self, gaussians: u32, width: u32) -> SyntheticArguments {
        SyntheticArguments {
            gaussians: Some(gaussians),
            sh_degree: Some(self.sh_degree),
            width: Some(width),
            height: Some(height_of(width)),
            seed: Some(self.seed),
        }
    }

    /// Measures a frame or a step.
    fn measure(
        &self,
        task: Task,
        context: &Context,
        yardsticks: &Yardsticks,
        (gaussians, width): (u32, u32),
    ) -> Result<Run> {
        let what = match task {
            Task::Frames => What::Render,
            Task::Steps => What::TrainStep,
        };
        let scene = Rc::new(self.scene(gaussians, width).load()?);
        let plan = Plan { what, scene, forms: Vec::new(), reads_back: true, seed: self.seed };
        let mut measured = frames::measure(context, &plan, self.iterations.get(), yardsticks.copy.as_ref())?;
        let (run, _) = measured.swap_remove(0);
        tell!("{}, {}: {:.2} ms", task.singular(), table::describe(&run.workload), run.wall_ms.median);
        Ok(run)
    }
}

impl Task {
    fn singular(self) -> &'static str {
        match self {
            Self::Frames => "frame",
            Self::Steps => "training step",
        }
    }

    fn plural(self) -> &'static str {
        match self {
            Self::Frames => "Frames",
            Self::Steps => "Training steps",
        }
    }
}

fn height_of(width: u32) -> u32 {
    if width <= 512 { width } else { width * 9 / 16 }
}

/// Device time of each stage, milliseconds; wall time first.
fn series(task: Task, sweep: &Sweep) -> Vec<Line> {
    let points = sweep.iter().map(|(x, r)| (*x, r.wall_ms.median)).collect();
    let whole = Line { name: task.singular().into(), points, band: Vec::new(), width: 3.0 };
    std::iter::once(whole).chain(grouped(sweep, |kernel| stage_of(&kernel.scope))).collect()
}

/// Device time of each kernel of each stage, milliseconds.
fn kernel_series(sweep: &Sweep) -> Vec<Line> {
    grouped(sweep, |kernel| format!("{}: {}", stage_of(&kernel.scope), kernel.kernel))
}

/// Device time of kernels grouped by name, milliseconds, in order of first appearance.
fn grouped(sweep: &Sweep, name_of: impl Fn(&KernelResult) -> String) -> Vec<Line> {
    let mut names: Vec<String> = Vec::new();
    for name in sweep.iter().flat_map(|(_, run)| &run.kernels).map(&name_of) {
        if !names.contains(&name) {
            names.push(name);
        }
    }
    let time = |run: &Run, name: &str| -> f64 {
        let own = run.kernels.iter().filter(|k| name_of(k) == name);
        own.filter_map(|k| k.time_us).map(|time| time.median * 1e-3).sum()
    };
    let of_name = |name: String| {
        let points = sweep.iter().map(|(x, run)| (*x, time(run, &name))).collect();
        Line { name, points, band: Vec::new(), width: 1.5 }
    };
    let mut all: Vec<Line> = names.into_iter().map(of_name).collect();
    all.retain(|series| series.points.iter().any(|&(_, time)| time > 0.0));
    all
}

fn stage_of(scope: &str) -> String {
    if scope.is_empty() { "read-back".to_owned() } else { scope.to_owned() }
}

/// Slope of the least-squares line through (ln x, ln y); none with fewer than two points.
fn exponent(points: &[(f64, f64)]) -> Option<f64> {
    let logs: Vec<(f64, f64)> =
        points.iter().filter(|(x, y)| *x > 0.0 && *y > 0.0).map(|(x, y)| (x.ln(), y.ln())).collect();
    let n = logs.len() as f64;
    let mean = |of: fn(&(f64, f64)) -> f64| logs.iter().map(of).sum::<f64>() / n;
    let (mx, my) = (mean(|p| p.0), mean(|p| p.1));
    let (mut above, mut below) = (0.0, 0.0);
    for (x, y) in &logs {
        above += (x - mx) * (y - my);
        below += (x - mx).powi(2);
    }
    (below > 1e-12).then(|| above / below)
}

/// A table of groups of series over the same x values.
fn exponents(axis: &str, groups: &[&[Line]]) -> String {
    let width = groups.iter().flat_map(|group| group.iter()).map(|series| series.name.len()).max();
    let width = width.unwrap_or(0).max(axis.len());
    let mut out = format!("{axis:<width$}");
    for (x, _) in groups.iter().find_map(|group| group.first()).map_or(&[][..], |series| &series.points) {
        out += &format!("{:>12}", thousands(*x as u64));
    }
    out += "   exponent\n";
    for group in groups {
        for series in *group {
            out += &format!("{:<width$}", series.name);
            for (_, y) in &series.points {
                // Zero means that the kernel does not run at this size.
                out += &if *y > 0.0 { format!("{y:>12.3}") } else { format!("{:>12}", "-") };
            }
            out += &exponent(&series.points).map_or_else(String::new, |e| format!("{e:>11.2}"));
            out.push('\n');
        }
        out.push('\n');
    }
    out.trim_end().to_owned()
}
