//! Two measurements, kernel by kernel.

use super::schema::{KernelResult, Spread};

/// Relative difference of times that counts as equal whatever their spread, because clocks and frequencies drift.
const DRIFT: f64 = 0.10;
/// Difference per call that counts as equal: the cost of a dispatch jitters by this much.
const JITTER_US: f64 = 10.0;

/// One kernel, or a whole iteration, in both measurements.
pub struct Row {
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

impl Row {
    /// A line for the time of a whole iteration.
    pub fn whole(run: &str, what: &str, a_us: Spread, b_us: Spread) -> Self {
        Self { run: run.to_owned(), scope: String::new(), kernel: what.to_owned(), calls: 1, a_us, b_us }
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
pub fn kernels(run: &str, a: &[KernelResult], b: &[KernelResult]) -> Vec<Row> {
    let mut lines = Vec::new();
    for kernel in a {
        if let (Some(a_us), Some(b_us)) = (kernel.time_us, time_of_twin(kernel, b)) {
            let (scope, name) = (kernel.scope.clone(), kernel.kernel.clone());
            lines.push(Row { run: run.to_owned(), scope, kernel: name, calls: kernel.calls, a_us, b_us });
        }
    }
    lines
}

pub fn table(lines: &[Row]) -> String {
    let mut out = format!(
        "{:<11} {:<16} {:<26} {:>11} {:>11} {:>7}  {:<16} {}\n",
        "run", "stage", "kernel", "A µs", "B µs", "B/A", "range", "verdict"
    );
    for line in lines {
        let Row { a_us: a, b_us: b, .. } = line;
        // Least and largest ratio that the two spreads allow.
        let (low, high) = (b.min / a.p90.max(1e-9), b.p90 / a.min.max(1e-9));
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
            a.median,
            b.median,
            b.median / a.median.max(1e-9),
            format!("{low:.2} to {high:.2}"),
        );
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_differ_beyond_their_spread_drift_and_jitter() {
        let verdict = |min: f64, p90: f64| {
            let a_us = Spread { min: 1000.0, median: 1050.0, p90: 1100.0, mean: 1050.0 };
            Row::whole("sort", "all", a_us, Spread { min, p90, ..a_us }).verdict()
        };
        assert_eq!(verdict(1210.0, 1300.0), Verdict::Same);
        assert_eq!(verdict(1230.0, 1300.0), Verdict::Slower);
        assert_eq!(verdict(850.0, 910.0), Verdict::Same);
        assert_eq!(verdict(850.0, 890.0), Verdict::Faster);
    }
}
