//! `bench compare`: two result files, kernel by kernel.

use super::schema::{KernelResult, Report, Run, SCHEMA, Spread, Workload};
use ashsplat::{Error, Result};
use ashsplat_files::regular_file;
use serde_json::Value;
use std::path::Path;

/// Relative difference of times that counts as equal whatever their spread, because clocks and frequencies drift.
const DRIFT: f64 = 0.10;
/// Difference per call that counts as equal: the cost of a dispatch jitters by this much.
const JITTER_US: f64 = 10.0;

/// One kernel, or a whole iteration, in both files.
pub struct Line {
    pub run: String,
    pub scope: String,
    pub kernel: String,
    pub calls: u32,
    pub a_us: Spread,
    pub b_us: Spread,
}

/// Judgement of B's time against A's.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    Same,
    Slower,
    Faster,
}

impl Line {
    /// A line for the time of a whole iteration.
    pub fn whole(run: &str, what: &str, a_us: Spread, b_us: Spread) -> Self {
        Self { run: run.to_owned(), scope: String::new(), kernel: what.to_owned(), calls: 1, a_us, b_us }
    }

    /// B's median over A's.
    pub fn ratio(&self) -> f64 {
        self.b_us.median / self.a_us.median.max(1e-9)
    }

    /// Least and largest ratio that the two spreads allow.
    pub fn ratio_range(&self) -> (f64, f64) {
        (self.b_us.min / self.a_us.p90.max(1e-9), self.b_us.p90 / self.a_us.min.max(1e-9))
    }

    /// Returns `Same` if the spreads overlap. A spread goes from the least to the 90th percentile, widened by drift and jitter.
    pub fn verdict(&self) -> Verdict {
        let slack = |time: f64| time * DRIFT + JITTER_US * f64::from(self.calls);
        if self.b_us.min > self.a_us.p90 + slack(self.a_us.p90) {
            Verdict::Slower
        } else if self.a_us.min > self.b_us.p90 + slack(self.b_us.p90) {
            Verdict::Faster
        } else {
            Verdict::Same
        }
    }
}

/// Reads a result file; refuses one of another schema.
pub fn read(path: &Path) -> Result<Report> {
    let text = regular_file::read_json(path)?;
    let value: Value = serde_json::from_slice(&text).map_err(|e| {
        Error::input(path, format!("is no JSON: {e}"), "give a file that `ashsplat bench` wrote")
    })?;
    let schema = value.get("schema").and_then(Value::as_str).unwrap_or("none");
    if schema != SCHEMA {
        let remedy = "measure again with this program, or compare with the one that wrote it";
        return Err(Error::input(
            path,
            format!("has schema '{schema}', this program reads '{SCHEMA}'"),
            remedy,
        ));
    }
    let report: Report = serde_json::from_value(value)
        .map_err(|e| Error::input(path, format!("does not follow {SCHEMA}: {e}"), ""))?;
    match report.runs.iter().find_map(broken_spread) {
        Some(problem) => Err(Error::input(path, problem, "measure again; the file was changed or damaged")),
        None => Ok(report),
    }
}

/// Names a spread of a run that no measurement can give; none if all are plausible.
fn broken_spread(run: &Run) -> Option<String> {
    let whole = [
        ("wall_ms", Some(run.wall_ms)),
        ("device_ms", run.device_ms),
        ("between_submissions_ms", run.between_submissions_ms),
        ("untimed_ms", run.untimed_ms),
        ("cpu_seconds", run.cpu_seconds),
    ];
    let of_kernels = run.kernels.iter().map(|kernel| (kernel.kernel.as_str(), kernel.time_us));
    let of_processor = run.cpu.iter().map(|sort| (sort.name.as_str(), Some(sort.time_ms)));
    let mut all = whole.into_iter().chain(of_kernels).chain(of_processor);
    let (name, Spread { min, median, p90, mean }) =
        all.find_map(|(name, spread)| Some((name, spread.filter(|spread| !spread.is_plausible())?)))?;
    Some(format!(
        "{} of {} is no spread of times: min {min}, median {median}, p90 {p90}, mean {mean}",
        name, run.name
    ))
}

/// Pairs up two reports; refuses those of different workloads.
pub fn compare(a: &Report, b: &Report) -> Result<Vec<Line>> {
    let names = |report: &Report| report.runs.iter().map(|r| r.name.clone()).collect::<Vec<_>>().join(", ");
    if names(a) != names(b) {
        let problem = format!("one has {}, the other {}; compare like with like", names(a), names(b));
        return Err(Error::argument("the runs differ", problem));
    }
    if a.runs.is_empty() {
        return Err(Error::argument("the results", "hold no runs; measure again"));
    }
    if a.settings.clock != b.settings.clock {
        let problem =
            format!("one has times of the {}, the other of the {}", a.settings.clock, b.settings.clock);
        return Err(Error::argument("the clocks differ", problem));
    }
    let mut lines = Vec::new();
    for (a, b) in a.runs.iter().zip(&b.runs) {
        check_workloads(a, b)?;
        let (all_a, all_b) = match (a.device_ms, b.device_ms) {
            (Some(a), Some(b)) => (a, b),
            (None, None) => (a.wall_ms, b.wall_ms),
            (one, _) => {
                let which = if one.is_some() { "A" } else { "B" };
                let problem = format!("only {which} has them; measure both by the same clock");
                return Err(Error::argument(format!("the device's times of {}", a.name), problem));
            }
        };
        lines.push(Line::whole(&a.name, "all", all_a.times(1e3), all_b.times(1e3)));
        if let (Some(cpu_a), Some(cpu_b)) = (a.cpu_seconds, b.cpu_seconds) {
            lines.push(Line::whole(&a.name, "processor time", cpu_a.times(1e6), cpu_b.times(1e6)));
        }
        lines.extend(kernels(&a.name, &a.kernels, &b.kernels));
    }
    Ok(lines)
}

/// Lists times that only one report has ("only in A: ..."), of kernels and of the processor. Also lists runs blended in
/// different forms.
pub fn unpaired(a: &Report, b: &Report) -> Vec<String> {
    let mut found = Vec::new();
    for (a, b) in a.runs.iter().zip(&b.runs) {
        if let (Some(a_form), Some(b_form)) = (&a.workload.blending, &b.workload.blending)
            && a_form != b_form
        {
            found.push(format!("{}: the form of blending is '{a_form}' in A, '{b_form}' in B", a.name));
        }
    }
    for (name, one, other) in [("A", a, b), ("B", b, a)] {
        for (one, other) in one.runs.iter().zip(&other.runs) {
            if one.cpu_seconds.is_some() && other.cpu_seconds.is_none() {
                found.push(format!("only in {name}: {} processor time", one.name));
            }
            let alone = alone(&one.kernels, &other.kernels);
            found.extend(
                alone.map(|(k, _)| format!("only in {name}: {} {} in '{}'", one.name, k.kernel, k.scope)),
            );
        }
    }
    found
}

/// Returns the time of the same kernel in the same stage.
fn time_of_twin(kernel: &KernelResult, among: &[KernelResult]) -> Option<Spread> {
    among.iter().find(|k| (&k.scope, &k.kernel) == (&kernel.scope, &kernel.kernel))?.time_us
}

/// Returns the kernels that have a time in one measurement only, with that time.
pub fn alone<'a>(
    one: &'a [KernelResult],
    other: &'a [KernelResult],
) -> impl Iterator<Item = (&'a KernelResult, Spread)> {
    let timed = one.iter().filter_map(|kernel| Some((kernel, kernel.time_us?)));
    timed.filter(|(kernel, _)| time_of_twin(kernel, other).is_none())
}

/// Pairs up the kernels of two measurements.
pub fn kernels(run: &str, a: &[KernelResult], b: &[KernelResult]) -> Vec<Line> {
    let mut lines = Vec::new();
    for kernel in a {
        if let (Some(a_us), Some(b_us)) = (kernel.time_us, time_of_twin(kernel, b)) {
            let (scope, name) = (kernel.scope.clone(), kernel.kernel.clone());
            lines.push(Line { run: run.to_owned(), scope, kernel: name, calls: kernel.calls, a_us, b_us });
        }
    }
    lines
}

fn check_workloads(a: &Run, b: &Run) -> Result<()> {
    let (wa, wb) = (&a.workload, &b.workload);
    // Training from points ends with as many Gaussians as it makes, so their number is no part of the workload.
    let grows = a.name.starts_with("train") && !a.name.starts_with("train-step");
    let gaussians = |w: &Workload| if grows { None } else { w.gaussians };
    let size = |w: &Workload| (w.elements, gaussians(w), w.sh_degree, w.width, w.height);
    if wa.hash == wb.hash && size(wa) == size(wb) {
        return Ok(());
    }
    let (da, db) = (super::table::describe(wa), super::table::describe(wb));
    let problem = if da == db {
        format!("the same counts but other contents (hashes {} and {}): {da}", wa.hash, wb.hash)
    } else {
        format!("{da} against {db}")
    };
    Err(Error::argument(format!("the workloads of {} differ", a.name), problem))
}

pub fn table(lines: &[Line]) -> String {
    let mut out = format!(
        "{:<11} {:<16} {:<26} {:>11} {:>11} {:>7}  {:<16} {}\n",
        "run", "stage", "kernel", "A µs", "B µs", "B/A", "range", "verdict"
    );
    for line in lines {
        let (low, high) = line.ratio_range();
        let verdict = match line.verdict() {
            Verdict::Same => "same",
            Verdict::Slower => "SLOWER",
            Verdict::Faster => "faster",
        };
        out += &format!(
            "{:<11} {:<16} {:<26} {:>11.1} {:>11.1} {:>7.3}  {:<16} {verdict}\n",
            line.run,
            line.scope,
            line.kernel,
            line.a_us.median,
            line.b_us.median,
            line.ratio(),
            format!("{low:.2} to {high:.2}"),
        );
    }
    out
}

/// Lists kernels that became more than `limit` times slower, beyond their spread: "sort sort/sort_upsweep in 'sort' 2.00 times".
pub fn slower(lines: &[Line], limit: f64) -> Vec<String> {
    let slow = lines.iter().filter(|line| line.verdict() == Verdict::Slower && line.ratio() > limit);
    let named = slow.map(|line| {
        let stage = if line.scope.is_empty() { String::new() } else { format!(" in '{}'", line.scope) };
        format!("{} {}{stage} {:.2} times", line.run, line.kernel, line.ratio())
    });
    named.collect()
}
