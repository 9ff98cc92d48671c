//! Times of two programs in turn, and a row of the table.

use std::time::Instant;

pub type Result<T> = std::result::Result<T, Box<dyn std::error::Error>>;

/// Milliseconds of a run: wall time, and processor time of all threads.
#[derive(Clone, Copy, Debug, Default)]
pub struct Run {
    wall: f64,
    cpu: f64,
}

impl std::fmt::Display for Run {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{:.1} ms, {:.1} CPU-ms", self.wall, self.cpu)
    }
}

/// Measures two programs in turn, so that other work on the machine affects both alike.
pub fn in_turn(
    runs: usize,
    mut ours: impl FnMut() -> Result<Run>,
    mut theirs: impl FnMut() -> Result<Run>,
) -> Result<[Run; 2]> {
    // The first run of each compiles and allocates.
    (ours()?, theirs()?);
    let mut all = [Vec::new(), Vec::new()];
    for _ in 0..runs {
        all[0].push(ours()?);
        all[1].push(theirs()?);
    }
    Ok(all.map(|runs| medians(&runs)))
}

pub fn alone(runs: usize, mut work: impl FnMut() -> Result<Run>) -> Result<Run> {
    work()?;
    Ok(medians(&(0..runs).map(|_| work()).collect::<Result<Vec<_>>>()?))
}

fn medians(runs: &[Run]) -> Run {
    Run { wall: median(runs, |run| run.wall), cpu: median(runs, |run| run.cpu) }
}

pub fn time(work: impl FnOnce() -> Result<()>) -> Result<Run> {
    let (before, start) = (cpu_ms(), Instant::now());
    work()?;
    Ok(Run { wall: 1e3 * start.elapsed().as_secs_f64(), cpu: cpu_ms() - before })
}

fn median(runs: &[Run], of: impl Fn(&Run) -> f64) -> f64 {
    let mut values: Vec<f64> = runs.iter().map(of).collect();
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Milliseconds that the process's threads have spent on processors. Linux only.
fn cpu_ms() -> f64 {
    let tasks = std::fs::read_dir("/proc/self/task").into_iter().flatten().flatten();
    let texts = tasks.filter_map(|task| std::fs::read_to_string(task.path().join("schedstat")).ok());
    texts.filter_map(|text| text.split_whitespace().next()?.parse::<f64>().ok()).sum::<f64>() * 1e-6
}

pub fn print(what: &str, [ours, theirs]: [Run; 2], likeness: &str) {
    let (wall, cpu) = (theirs.wall / ours.wall, theirs.cpu / ours.cpu);
    println!("| {what} | {ours} | {theirs} | {wall:.2}, {cpu:.2} | {likeness} |");
}
