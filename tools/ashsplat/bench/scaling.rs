//! `bench scaling`: how each kernel grows with the Gaussians and with the pixels.

use super::arguments::{IterationArguments, OutputArguments};
use super::frames;
use super::measure::{Iterations, Yardsticks};
use super::plot::{Panel, Series};
use super::schema::{Report, Run};
use super::workload::SyntheticArguments;
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
    #[arg(long, value_name = "N,N,...", value_delimiter = ',', default_values_t = [10_000, 30_000, 100_000, 300_000, 1_000_000], value_parser = clap::value_parser!(u32).range(1..))]
    counts: Vec<u32>,
    /// Width of the pictures meanwhile, pixels
    #[arg(long, value_name = "PIXELS", default_value_t = 960, value_parser = clap::value_parser!(u32).range(1..))]
    width: u32,
    /// Widths of the pictures: square to 512, 16:9 above
    #[arg(long, value_name = "N,N,...", value_delimiter = ',', default_values_t = [256, 512, 1024, 1920, 3840], value_parser = clap::value_parser!(u32).range(1..))]
    widths: Vec<u32>,
    /// Gaussians meanwhile
    #[arg(long, value_name = "N", default_value_t = SyntheticArguments::GAUSSIANS, value_parser = clap::value_parser!(u32).range(1..))]
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
        panels.iter().for_each(|panel| say!("{}", exponents(panel)));
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
    /// A frame of so many Gaussians and so wide.
    fn measure(
        &self,
        context: &Context,
        yardsticks: &Yardsticks,
        (gaussians, width): (u32, u32),
    ) -> Result<Run> {
        let scene = SyntheticArguments {
            gaussians: Some(gaussians),
            sh_degree: Some(self.sh_degree),
            width: Some(width),
            height: Some(height_of(width)),
            seed: Some(self.seed),
        };
        let scene = scene.load()?;
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
    let mut names: Vec<String> = Vec::new();
    for kernel in sweep.iter().flat_map(|(_, run)| &run.kernels) {
        let stage = stage_of(&kernel.scope);
        if !names.contains(&stage) {
            names.push(stage);
        }
    }
    let mut all = vec![Series {
        name: "frame".into(),
        points: sweep.iter().map(|(x, r)| (*x, r.wall_ms.median)).collect(),
    }];
    for name in names {
        let time = |run: &Run| -> f64 {
            let own = run.kernels.iter().filter(|k| stage_of(&k.scope) == name);
            own.filter_map(|k| k.time_us).map(|time| time.median * 1e-3).sum()
        };
        let points: Vec<_> = sweep.iter().map(|(x, run)| (*x, time(run))).collect();
        all.push(Series { name, points });
    }
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

fn exponents(panel: &Panel) -> String {
    let mut out =
        format!("\n{}: milliseconds by {}, and the exponent of their growth\n", panel.title, panel.axis);
    out += &format!("{:<18}", panel.axis);
    for (x, _) in panel.series.first().map_or(&[][..], |series| &series.points) {
        out += &format!("{:>12}", table::grouped(*x as u64));
    }
    out += "   exponent\n";
    for series in &panel.series {
        out += &format!("{:<18}", series.name);
        for (_, y) in &series.points {
            out += &format!("{y:>12.3}");
        }
        out += &exponent(&series.points).map_or_else(String::new, |e| format!("{e:>11.2}"));
        out.push('\n');
    }
    out
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
