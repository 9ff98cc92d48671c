//! Measures wall-clock and processor time of a run.

use std::fs;
use std::time::Instant;

/// A stopwatch for wall-clock and processor time that can be paused.
pub struct Stopwatch {
    start: Instant,
    cpu_start: Option<f64>,
    /// Wall-clock and processor time before the last pause.
    before: (f64, f64),
}

/// Cost of a number of iterations.
#[derive(Clone, Copy)]
pub struct Cost {
    pub iterations: u32,
    pub seconds: f64,
    /// User and system time of the whole process; `None` if the system does not report it.
    pub cpu_seconds: Option<f64>,
}

impl Stopwatch {
    pub fn start() -> Stopwatch {
        Stopwatch { start: Instant::now(), cpu_start: process_seconds(), before: (0.0, 0.0) }
    }

    /// Runs a task whose time does not count.
    pub fn paused<T>(&mut self, task: impl FnOnce() -> T) -> T {
        let so_far = self.cost(0);
        let result = task();
        *self = Stopwatch::start();
        self.before = (so_far.seconds, so_far.cpu_seconds.unwrap_or(0.0));
        result
    }

    /// Time spent so far, for a number of iterations.
    pub fn cost(&self, iterations: u32) -> Cost {
        // The clock counts living threads only, so it goes back when one ends.
        let since = |start: f64, now: f64| (now - start).max(0.0);
        let cpu = self.cpu_start.zip(process_seconds()).map(|(start, now)| since(start, now) + self.before.1);
        Cost { iterations, seconds: self.before.0 + self.start.elapsed().as_secs_f64(), cpu_seconds: cpu }
    }
}

impl std::fmt::Display for Cost {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let n = f64::from(self.iterations.max(1));
        write!(f, "{:.2} it/s", n / self.seconds.max(1e-9))?;
        match self.cpu_seconds {
            Some(cpu) => write!(f, ", {:.4} CPU-seconds per iteration", cpu / n),
            None => Ok(()),
        }
    }
}

/// Median; of an even number of values the mean of the middle two. None without values.
pub fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_unstable_by(f64::total_cmp);
    let n = values.len();
    // The same value twice if their number is odd.
    (n > 0).then(|| 0.5 * (values[(n - 1) / 2] + values[n / 2]))
}

/// User and system time of all living threads so far, seconds: to the nanosecond if the kernel keeps scheduling
/// statistics, else in hundredths of a second. `None` if the system reports neither.
pub fn process_seconds() -> Option<f64> {
    scheduled_seconds().or_else(ticked_seconds)
}

/// First field of /proc/self/task/*/schedstat: nanoseconds on a processor.
fn scheduled_seconds() -> Option<f64> {
    let mut nanoseconds = 0.0;
    for task in fs::read_dir("/proc/self/task").ok()? {
        let text = fs::read_to_string(task.ok()?.path().join("schedstat")).ok()?;
        nanoseconds += text.split_whitespace().next()?.parse::<f64>().ok()?;
    }
    (nanoseconds > 0.0).then_some(nanoseconds * 1e-9)
}

fn ticked_seconds() -> Option<f64> {
    /// Linux fixes the unit for user space.
    const TICKS_PER_SECOND: f64 = 100.0;
    let stat = fs::read_to_string("/proc/self/stat").ok()?;
    // The second field is the program's name in parentheses, which may contain anything. Fields are counted after it.
    let fields: Vec<&str> = stat.rsplit_once(')')?.1.split_whitespace().collect();
    let ticks = |index: usize| fields.get(index)?.parse::<f64>().ok();
    Some((ticks(11)? + ticks(12)?) / TICKS_PER_SECOND)
}

#[cfg(test)]
mod tests {
    #[test]
    fn work_costs_processor_time() {
        let Some(before) = super::process_seconds() else { return };
        let mut sum = 0.0f64;
        for i in 0..20_000_000 {
            sum += f64::from(i).sqrt();
        }
        assert!(sum > 0.0);
        let spent = super::process_seconds().expect("as before") - before;
        assert!(spent > 0.001, "{spent}");
    }
}
