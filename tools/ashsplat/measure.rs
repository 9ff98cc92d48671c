//! What a run costs: wall-clock and processor time.

use std::time::Instant;

/// Unit of the processor times in /proc: Linux fixes it at 100 per second for user space.
const TICKS_PER_SECOND: f64 = 100.0;

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
    /// User and system time of the whole process; none where the system does not tell.
    pub cpu_seconds: Option<f64>,
}

impl Stopwatch {
    pub fn start() -> Stopwatch {
        Stopwatch { start: Instant::now(), cpu_start: process_cpu_seconds(), before: (0.0, 0.0) }
    }

    /// Does something that does not count.
    pub fn paused<T>(&mut self, task: impl FnOnce() -> T) -> T {
        let so_far = self.cost(0);
        let result = task();
        *self = Stopwatch::start();
        self.before = (so_far.seconds, so_far.cpu_seconds.unwrap_or(0.0));
        result
    }

    /// What has been spent so far, for a number of iterations.
    pub fn cost(&self, iterations: u32) -> Cost {
        let cpu = self.cpu_start.zip(process_cpu_seconds()).map(|(start, now)| now - start + self.before.1);
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

/// User and system time of this process so far, from /proc/self/stat.
fn process_cpu_seconds() -> Option<f64> {
    let stat = std::fs::read_to_string("/proc/self/stat").ok()?;
    // The second field is the program's name in parentheses and may hold anything; count from behind it.
    let fields: Vec<&str> = stat.rsplit_once(')')?.1.split_whitespace().collect();
    let ticks = |index: usize| fields.get(index)?.parse::<f64>().ok();
    Some((ticks(11)? + ticks(12)?) / TICKS_PER_SECOND)
}
