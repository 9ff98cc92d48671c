//! `bench scaling`: how each stage and kernel grows with the Gaussians and with the pixels.

use super::arguments::{IterationArguments, OutputArguments};
use super::frames;
use super::measure::{Iterations, Yardsticks};
use super::plot::{Panel, Series};
use super::schema::{KernelResult, Report, Run};
use super::workload::{MOST_GAUSSIANS, SyntheticArguments};
use super::{assemble, plot, table};
use crate::output;
use ashsplat::Result;
use ashsplat::vk::Context;
use clap::Args;
use std::path::PathBuf;

/// Sweep the number of Gaussians at one resolution, then the resolution at one number of Gaussians, and fit how the
/// time of each stage grows: time ~ count^exponent.
#[derive(Args)]
pub struct Arguments {
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

/// Points of one sweep: how large, and what was measured.
type Sweep = Vec<(f64, Run)>;

/// Runs the command.
pub fn run(arguments: &Arguments) -> Result<()> {
    arguments.output.check(&[("--plot", arguments.plot.as_deref())])?;
    for &count in arguments.counts.iter().chain([&arguments.gaussians]) {
        arguments.scene(count, arguments.width).check()?;
    }
    let context = arguments.output.context()?;
    let yardsticks = Yardsticks::measure(&context)?;
    let (mut by_count, mut by_pixels): (Sweep, Sweep) = (Vec::new(), Vec::new());
    for &count in &arguments.counts {
        let run = arguments.measure(&context, &yardsticks, (count, arguments.width))?;
        by_count.push((f64::from(count), run));
    }
    for &width in &arguments.widths {
        let run = arguments.measure(&context, &yardsticks, (arguments.gaussians, width))?;
        by_pixels.push((f64::from(width) * f64::from(height_of(width)), run));
    }
    let growth = |title: String, axis: &str, sweep: &Sweep| Panel {
        title,
        axis: axis.to_owned(),
        series: series(sweep),
    };
    let (width, fixed) = (arguments.width, table::grouped(arguments.gaussians.into()));
    let panels = [
        growth(format!("{width}x{} pixels", height_of(width)), "Gaussians", &by_count),
        growth(format!("{fixed} Gaussians"), "pixels", &by_pixels),
    ];
    if !arguments.output.quiet {
        for (panel, sweep) in panels.iter().zip([&by_count, &by_pixels]) {
            let title =
                format!("{}: milliseconds by {}, and the exponent of their growth", panel.title, panel.axis);
            say!("\n{title}\n{}", exponents(&panel.axis, &[&panel.series[..], &kernel_series(sweep)]));
        }
    }
    let mut runs = by_count.into_iter().chain(by_pixels).map(|(_, run)| run).collect::<Vec<_>>();
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
    fn scene(&self, gaussians: u32, width: u32) -> SyntheticArguments {
        SyntheticArguments {
            gaussians: Some(gaussians),
            sh_degree: Some(self.sh_degree),
            width: Some(width),
            height: Some(height_of(width)),
            seed: Some(self.seed),
        }
    }

    /// A frame of so many Gaussians and so wide.
    fn measure(
        &self,
        context: &Context,
        yardsticks: &Yardsticks,
        (gaussians, width): (u32, u32),
    ) -> Result<Run> {
        let scene = self.scene(gaussians, width).load()?;
        let iterations: Iterations = self.iterations.get();
        let (copy, seed) = (yardsticks.copy.as_ref(), self.seed);
        let (run, _) = frames::render(&frames::Job { context, iterations, copy, scene: &scene, seed })?;
        tell!("{}: {:.2} ms", table::describe(&run.workload), run.wall_ms.median);
        Ok(run)
    }
}

fn height_of(width: u32) -> u32 {
    if width <= 512 { width } else { width * 9 / 16 }
}

/// Device time of each stage, milliseconds; the wall time first.
fn series(sweep: &Sweep) -> Vec<Series> {
    let wall = sweep.iter().map(|(x, r)| (*x, r.wall_ms.median)).collect();
    let frame = Series { name: "frame".into(), points: wall };
    std::iter::once(frame).chain(grouped(sweep, |kernel| stage_of(&kernel.scope))).collect()
}

/// Device time of each kernel of each stage, milliseconds.
fn kernel_series(sweep: &Sweep) -> Vec<Series> {
    grouped(sweep, |kernel| format!("{}: {}", stage_of(&kernel.scope), kernel.kernel))
}

/// Device time of the kernels of the same name, milliseconds, in the order of their first appearance.
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

/// Slope of the least-squares line through (ln x, ln y); None with fewer than two points.
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

/// A table of groups of series over the same places.
fn exponents(axis: &str, groups: &[&[Series]]) -> String {
    let width = groups.iter().flat_map(|group| group.iter()).map(|series| series.name.len()).max();
    let width = width.unwrap_or(0).max(axis.len());
    let mut out = format!("{axis:<width$}");
    for (x, _) in groups.iter().find_map(|group| group.first()).map_or(&[][..], |series| &series.points) {
        out += &format!("{:>12}", table::grouped(*x as u64));
    }
    out += "   exponent\n";
    for group in groups {
        for series in *group {
            out += &format!("{:<width$}", series.name);
            for (_, y) in &series.points {
                // A sum of nothing: the kernel does not run at this size.
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
