//! Measures wall-clock and processor time of a run.

use std::time::Instant;

/// A stopwatch for wall-clock and processor time that can be paused.
pub struct Stopwatch {
    start: Instant,
    cpu_start: Option<f64>,
    /// Wall-clock and processor time before the last pause.
    before: (f64, f64),
}

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
        let cpu = self.cpu_start.zip(process_seconds()).map(|(start, now)| now - start + self.before.1);
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

/// User and system time of the whole process so far, seconds; `None` if the system does not report it.
pub fn process_seconds() -> Option<f64> {
    #[cfg(unix)]
    {
        let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
        Some(time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9)
    }
    #[cfg(not(unix))]
    {
        use sysinfo::{ProcessRefreshKind, ProcessesToUpdate, System};
        let own = sysinfo::get_current_pid().ok()?;
        let (mut system, kind) = (System::new(), ProcessRefreshKind::nothing().with_cpu());
        system.refresh_processes_specifics(ProcessesToUpdate::Some(&[own]), false, kind);
        Some(system.process(own)?.accumulated_cpu_time() as f64 * 1e-3)
    }
}
