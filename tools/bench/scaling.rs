//! `bench scaling`: how the time of each stage and kernel grows with the Gaussians and with the pixels.

use super::arguments::{IterationArguments, OutputArguments};
use super::measure::{Iterations, Yardsticks};
use super::plot::{Panel, Series};
use super::schema::{KernelResult, Report, Run};
use super::workload::{MOST_GAUSSIANS, SyntheticArguments};
use super::{assemble, frames, plot, table};
use ashsplat::frame::max_trained_gaussians;
use ashsplat::vk::Context;
use ashsplat::{Error, Result};
use ashsplat_program::output;
use ashsplat_program::progress::thousands;
use clap::{Args, ValueEnum};
use std::path::PathBuf;

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
        let growth = |fixed: String, axis: &str, sweep: &Sweep| Panel {
            title: format!("{}, {fixed}", task.plural()),
            axis: axis.to_owned(),
            series: series(task, sweep),
        };
        panels.push(growth(format!("{width}x{} pixels", height_of(width)), "Gaussians", &by_count));
        panels.push(growth(format!("{fixed} Gaussians"), "pixels", &by_pixels));
        sweeps.extend([by_count, by_pixels]);
    }
    if !arguments.output.quiet {
        for (panel, sweep) in panels.iter().zip(&sweeps) {
            let title =
                format!("{}: milliseconds by {}, and the exponent of their growth", panel.title, panel.axis);
            say!("\n{title}\n{}", exponents(&panel.axis, &[&panel.series[..], &kernel_series(sweep)]));
        }
    }
    let mut runs = sweeps.into_iter().flatten().map(|(_, run)| run).collect::<Vec<_>>();
    super::name_apart(&mut runs);
    let report: Report = assemble(&context, arguments.iterations.get(), arguments.seed, (yardsticks, runs));
    arguments.output.write(&report)?;
    if let Some(path) = &arguments.plot {
        let subtitle = format!("{}, {}", report.device.name, report.device.driver);
        output::write_text(path, &plot::svg(&subtitle, &panels))?;
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
        let scene = self.scene(gaussians, width).load()?;
        let iterations: Iterations = self.iterations.get();
        let (copy, seed) = (yardsticks.copy.as_ref(), self.seed);
        let job = frames::Job { context, iterations, copy, scene: &scene, blending: None, seed };
        let (run, _) = match task {
            Task::Frames => frames::render(&job)?,
            Task::Steps => frames::train_step(&job)?,
        };
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
fn series(task: Task, sweep: &Sweep) -> Vec<Series> {
    let wall = sweep.iter().map(|(x, r)| (*x, r.wall_ms.median)).collect();
    let whole = Series { name: task.singular().into(), points: wall };
    std::iter::once(whole).chain(grouped(sweep, |kernel| stage_of(&kernel.scope))).collect()
}

/// Device time of each kernel of each stage, milliseconds.
fn kernel_series(sweep: &Sweep) -> Vec<Series> {
    grouped(sweep, |kernel| format!("{}: {}", stage_of(&kernel.scope), kernel.kernel))
}

/// Device time of kernels grouped by name, milliseconds, in order of first appearance.
fn grouped(sweep: &Sweep, name_of: impl Fn(&KernelResult) -> String) -> Vec<Series> {
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
    let of_name =
        |name: String| Series { points: sweep.iter().map(|(x, run)| (*x, time(run, &name))).collect(), name };
    let mut all: Vec<Series> = names.into_iter().map(of_name).collect();
    all.retain(|series| series.points.iter().any(|&(_, time)| time > 0.0));
    all
}

fn stage_of(scope: &str) -> String {
    if scope.is_empty() { "read-back".to_owned() } else { scope.to_owned() }
}

/// Slope of the least-squares line through (ln x, ln y); none with fewer than two points.
pub fn exponent(points: &[(f64, f64)]) -> Option<f64> {
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
fn exponents(axis: &str, groups: &[&[Series]]) -> String {
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

#[cfg(test)]
mod tests {
    use super::exponent;

    #[test]
    fn exponent_of_a_power_law() {
        let points: Vec<(f64, f64)> = (1..6).map(|i| (f64::from(i), 3.0 * f64::from(i).powf(1.5))).collect();
        assert!((exponent(&points).expect("points") - 1.5).abs() < 1e-9);
        assert_eq!(exponent(&points[..1]), None);
        assert_eq!(exponent(&[]), None);
    }
}
