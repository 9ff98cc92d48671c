//! Runs of the same strategy combined: means, and ranges over the seeds.

use super::runs::{Point, Run};
use ashsplat_program::chart::{Axis, Line, Panel, figure};
use ashsplat_program::progress::thousands;
use serde::Serialize;
use std::fmt::Write;

#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Range {
    pub mean: f64,
    pub least: f64,
    pub most: f64,
}

impl Range {
    /// None without values.
    pub fn of(values: impl Iterator<Item = f64>) -> Option<Range> {
        let values: Vec<f64> = values.collect();
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        let (least, most) =
            values.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, m), &x| (l.min(x), m.max(x)));
        (!values.is_empty()).then_some(Range { mean, least, most })
    }

    /// The mean, and the ends in parentheses if they differ.
    fn describe(&self, digits: usize) -> String {
        let Range { mean, least, most } = self;
        match least < most {
            true => format!("{mean:.digits$} ({least:.digits$} to {most:.digits$})"),
            false => format!("{mean:.digits$}"),
        }
    }
}

/// A point of the curve.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Place {
    pub iteration: u32,
    pub psnr: Range,
    pub ssim: Range,
    pub gaussians: Range,
    pub seconds: Range,
    /// None if the system does not report it.
    pub cpu_seconds: Option<Range>,
}

/// Cost of reaching a PSNR.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Reached {
    /// dB.
    pub psnr: f64,
    /// Number of runs that reach it.
    pub runs: usize,
    pub seconds: Option<Range>,
    pub cpu_seconds: Option<Range>,
}

/// All runs of a strategy.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Curve {
    pub strategy: String,
    pub seeds: Vec<u32>,
    pub places: Vec<Place>,
    pub until: Vec<Reached>,
}

/// One curve for each strategy with a finished run.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Summary {
    pub curves: Vec<Curve>,
}

impl Summary {
    /// `strategies`: order of the curves.
    pub fn new(strategies: &[String], runs: &[Run], until: &[f64]) -> Summary {
        let of = |strategy: &String| {
            let own: Vec<&Run> = runs.iter().filter(|run| run.strategy == *strategy).collect();
            Curve::new(strategy, &own, until)
        };
        Summary { curves: strategies.iter().filter_map(of).collect() }
    }

    /// Length of the runs, in words.
    pub fn iterations(&self) -> String {
        let last = self.curves.first().and_then(|curve| curve.places.last());
        last.map_or_else(String::new, |place| format!("{} iterations", thousands(place.iteration.into())))
    }

    /// Table of the final results, and of the cost of the given PSNRs.
    pub fn table(&self) -> String {
        let name = self.curves.iter().map(|curve| curve.strategy.len()).max().unwrap_or(0).max(8);
        let mut out = String::new();
        for curve in &self.curves {
            let Some(end) = curve.places.last() else { continue };
            let cpu = end.cpu_seconds.map_or_else(String::new, |cpu| format!(", {} CPU-s", cpu.describe(1)));
            let _ = writeln!(
                out,
                "{:<name$} PSNR {} dB, SSIM {}, {} Gaussians{cpu}, {} s; {} seeds",
                curve.strategy,
                end.psnr.describe(2),
                end.ssim.describe(4),
                end.gaussians.describe(0),
                end.seconds.describe(1),
                curve.seeds.len()
            );
            for reached in &curve.until {
                let of = curve.seeds.len();
                let psnr = reached.psnr;
                let cost = |range: Option<Range>, unit: &str| {
                    range.map_or_else(String::new, |range| format!(", {} {unit}", range.describe(1)))
                };
                let _ = match reached.runs {
                    0 => writeln!(out, "{:<name$}   {psnr} dB: not reached", ""),
                    runs => writeln!(
                        out,
                        "{:<name$}   {psnr} dB: by {runs} of {of}{}{}",
                        "",
                        cost(reached.cpu_seconds, "CPU-s"),
                        cost(reached.seconds, "s")
                    ),
                };
            }
        }
        out
    }

    /// Draws PSNR, SSIM and Gaussians by processor seconds, and PSNR by iteration: means over the seeds, with a band from the
    /// least to the most. Uses seconds if the system does not report processor seconds.
    pub fn plot(&self, title: &str, until: &[f64]) -> String {
        type Value = fn(&Place) -> Option<Range>;
        let mut places = self.curves.iter().flat_map(|curve| &curve.places);
        let (along, cost): (_, Value) = match places.all(|place| place.cpu_seconds.is_some()) {
            true => ("CPU-seconds of training", |place| place.cpu_seconds),
            false => ("seconds of training", |place| Some(place.seconds)),
        };
        let iteration: Value = |place| Range::of(std::iter::once(f64::from(place.iteration)));
        let panel = |upwards, along: &str, (x, y): (Value, Value), levels: &[f64]| {
            let values = |curve: &Curve| -> Vec<(f64, Range)> {
                curve.places.iter().filter_map(|place| Some((x(place)?.mean, y(place)?))).collect()
            };
            let line = |curve: &Curve| Line {
                name: format!("{} ({} seeds)", curve.strategy, curve.seeds.len()),
                points: values(curve).iter().map(|(x, y)| (*x, y.mean)).collect(),
                band: values(curve).iter().map(|(x, y)| (*x, y.least, y.most)).collect(),
                width: 2.0,
            };
            let lines: Vec<Line> = self.curves.iter().map(line).collect();
            let band = || lines.iter().flat_map(|line| &line.band);
            let (right, high) = band().fold((0.0, 0.0), |(x, y): (f64, f64), at| (x.max(at.0), y.max(at.2)));
            let low = if upwards == "Gaussians" { 0.0 } else { band().map(|at| at.1).fold(high, f64::min) };
            let (x, y) = (Axis::new(0.0, right), Axis::new(low, high));
            let (title, along) = (String::new(), along.to_owned());
            Panel { title, along, upwards, x, y, lines, levels: levels.to_vec() }
        };
        let psnr: Value = |place| Some(place.psnr);
        let panels = [
            panel("PSNR, dB", along, (cost, psnr), until),
            panel("PSNR, dB", "iteration", (iteration, psnr), until),
            panel("SSIM", along, (cost, |place| Some(place.ssim)), &[]),
            panel("Gaussians", along, (cost, |place| Some(place.gaussians)), &[]),
        ];
        figure(title, &panels)
    }
}

impl Curve {
    fn new(strategy: &str, runs: &[&Run], until: &[f64]) -> Option<Curve> {
        let all: Vec<&[Point]> = runs.iter().map(|run| &run.points[..]).collect();
        let length = all.iter().map(|points| points.len()).min().filter(|&length| length > 0)?;
        let place = |k: usize| {
            let of = |value: &dyn Fn(&Point) -> f64| Range::of(all.iter().map(|points| value(&points[k])));
            let cpu: Option<Vec<f64>> = all.iter().map(|points| points[k].cpu_seconds).collect();
            Some(Place {
                iteration: all[0][k].iteration,
                psnr: of(&|p| p.psnr)?,
                ssim: of(&|p| p.ssim)?,
                gaussians: of(&|p| f64::from(p.gaussians))?,
                seconds: of(&|p| p.seconds)?,
                cpu_seconds: cpu.and_then(|cpu| Range::of(cpu.into_iter())),
            })
        };
        let reached = |&psnr: &f64| {
            let costs: Vec<(f64, Option<f64>)> =
                all.iter().filter_map(|points| cost_of(points, psnr)).collect();
            let cpu: Option<Vec<f64>> = costs.iter().map(|cost| cost.1).collect();
            Reached {
                psnr,
                runs: costs.len(),
                seconds: Range::of(costs.iter().map(|cost| cost.0)),
                cpu_seconds: cpu.and_then(|cpu| Range::of(cpu.into_iter())),
            }
        };
        Some(Curve {
            strategy: strategy.to_owned(),
            seeds: runs.iter().map(|run| run.seed).collect(),
            places: (0..length).map(place).collect::<Option<_>>()?,
            until: until.iter().map(reached).collect(),
        })
    }
}

/// Seconds and processor seconds until a PSNR is first reached, interpolated between two measurements.
fn cost_of(points: &[Point], psnr: f64) -> Option<(f64, Option<f64>)> {
    let place = points.iter().position(|point| point.psnr >= psnr)?;
    let end = &points[place];
    let Some(start) = place.checked_sub(1).map(|before| &points[before]) else {
        return Some((end.seconds, end.cpu_seconds));
    };
    let share = (psnr - start.psnr) / (end.psnr - start.psnr);
    let between = |from: f64, to: f64| from + share * (to - from);
    let cpu = start.cpu_seconds.zip(end.cpu_seconds).map(|(from, to)| between(from, to));
    Some((between(start.seconds, end.seconds), cpu))
}
