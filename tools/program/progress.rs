//! Progress on stderr: a bar on a terminal, plain lines elsewhere, nothing with `--quiet`.

use ashsplat::train::TrainSettings;
use indicatif::{HumanCount, ProgressBar, ProgressStyle};
use std::io::IsTerminal;
use std::time::{Duration, Instant};

/// Iterations between two plain lines.
const LINE_INTERVAL: u32 = 100;
/// Longest time between two plain lines.
const LONGEST_SILENCE: Duration = Duration::from_secs(30);
/// Weight of the newest loss in the running mean, as in the reference.
const LOSS_WEIGHT: f64 = 0.4;
/// Weight of the newest measurement in the speed that gives the remaining time.
const SPEED_WEIGHT: f64 = 0.3;

pub struct State {
    pub iteration: u32,
    pub loss: f32,
    pub gaussians: u32,
    pub memory_bytes: u64,
}

pub struct RunningMean {
    weight: f64,
    mean: Option<f64>,
}

impl RunningMean {
    pub fn new(weight: f64) -> Self {
        Self { weight, mean: None }
    }

    /// Adds a value. Values that are not finite, such as the loss of a skipped iteration, are left out.
    pub fn add(&mut self, value: f64) {
        if value.is_finite() {
            self.mean = Some(self.mean.map_or(value, |mean| mean + self.weight * (value - mean)));
        }
    }

    pub fn value(&self) -> Option<f64> {
        self.mean
    }
}

pub struct TrainProgress {
    bar: Option<ProgressBar>,
    lines: bool,
    /// Number of iterations before the start.
    first: u32,
    iterations: u32,
    /// The last densification, or the end of the warm-up. Iterations after it take equally long.
    settled_from: u32,
    /// Time and iteration at which the current measurement of the speed began.
    window: (Instant, u32),
    iterations_per_second: f64,
    /// Seconds per iteration.
    mean_seconds: RunningMean,
    mean_loss: RunningMean,
    /// Time of the last plain line.
    last_line: Instant,
    /// True once [`TrainProgress::first_estimate`] was given.
    estimated: bool,
    psnr: Option<(f64, u32)>,
}

impl TrainProgress {
    /// Progress of a run from iteration `first` on, 0 for a new one.
    pub fn new(first: u32, settings: &TrainSettings, quiet: bool) -> TrainProgress {
        let iterations = settings.iterations;
        let terminal = std::io::stderr().is_terminal();
        let bar = (terminal && !quiet).then(|| bar(u64::from(iterations), "{wide_bar} {pos}/{len}  {msg}"));
        TrainProgress {
            bar,
            lines: !terminal && !quiet,
            first,
            iterations,
            settled_from: settings.last_densification().unwrap_or(0).max(settings.warm_up_end()),
            window: (Instant::now(), first),
            iterations_per_second: 0.0,
            mean_seconds: RunningMean::new(SPEED_WEIGHT),
            mean_loss: RunningMean::new(LOSS_WEIGHT),
            last_line: Instant::now(),
            estimated: false,
            psnr: None,
        }
    }

    pub fn step(&mut self, state: &State) {
        self.mean_loss.add(state.loss.into());
        let seconds = self.window.0.elapsed().as_secs_f64();
        // Kernels are built in the first iteration, so it does not count.
        if state.iteration == self.first + 1 {
            self.window = (Instant::now(), state.iteration);
        } else if seconds > 1.0 || self.iterations_per_second == 0.0 {
            self.iterations_per_second = f64::from(state.iteration - self.window.1) / seconds.max(1e-9);
            self.window = (Instant::now(), state.iteration);
            self.mean_seconds.add(self.iterations_per_second.recip());
        }
        if let Some(bar) = &self.bar {
            bar.set_position(u64::from(state.iteration));
            bar.set_message(self.describe(state));
        } else if self.lines
            && (state.iteration.is_multiple_of(LINE_INTERVAL)
                || state.iteration == self.iterations
                || self.last_line.elapsed() > LONGEST_SILENCE)
        {
            errln!("{}/{}  {}", state.iteration, self.iterations, self.describe(state));
            self.last_line = Instant::now();
        }
    }

    /// The remaining seconds after this iteration, once: as soon as the speed is known. The run takes longer if Gaussians
    /// are added.
    pub fn first_estimate(&mut self, iteration: u32) -> Option<f64> {
        let seconds = self.mean_seconds.value().filter(|_| !self.estimated)?;
        self.estimated = true;
        Some(f64::from(self.iterations - iteration) * seconds)
    }

    pub fn tested(&mut self, psnr: f64, iteration: u32) {
        self.psnr = Some((psnr, iteration)).filter(|_| !psnr.is_nan());
    }

    /// Prints a line above the bar.
    pub fn note(&self, text: &str) {
        match &self.bar {
            Some(bar) => bar.suspend(|| errln!("{text}")),
            None if self.lines => errln!("{text}"),
            None => {}
        }
    }

    /// Prints a line on stderr, even with `--quiet`.
    pub fn warn(&self, text: &str) {
        match &self.bar {
            Some(bar) => bar.suspend(|| errln!("{text}")),
            None => errln!("{text}"),
        }
    }

    /// Ends the progress and leaves the bar visible.
    pub fn finish(&self) {
        if let Some(bar) = &self.bar {
            bar.abandon();
            // The next output begins on a new line.
            errln!("");
        }
    }

    fn describe(&self, state: &State) -> String {
        let psnr = self.psnr.map_or_else(|| "-".into(), |(psnr, at)| format!("{psnr:.2} at {at}"));
        let left = match (self.iterations - state.iteration, self.mean_seconds.value()) {
            (0, _) | (_, None) => String::new(),
            (left, Some(seconds)) => {
                let more = if state.iteration < self.settled_from { "more than " } else { "" };
                format!("  {more}{} left", clock(f64::from(left) * seconds))
            }
        };
        format!(
            "{:.1} it/s  loss {:.4}  PSNR {psnr}  {} Gaussians  {} MiB{left}",
            self.iterations_per_second,
            self.mean_loss.value().unwrap_or(0.0),
            thousands(u64::from(state.gaussians)),
            state.memory_bytes >> 20,
        )
    }
}

/// Progress of counted things, whose name is the unit: frames, views.
pub fn counting(what: &'static str, total: u64, quiet: bool) -> ProgressBar {
    counting_in(what, "", total, quiet)
}

pub fn counting_in(what: &'static str, unit: &'static str, total: u64, quiet: bool) -> ProgressBar {
    // An empty bar would look full.
    if quiet || total == 0 || !std::io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let bar = bar(total, "{msg} {wide_bar} {pos}/{len} {prefix}");
    bar.set_message(what);
    bar.set_prefix(unit);
    bar
}

fn bar(total: u64, template: &str) -> ProgressBar {
    let bar = ProgressBar::new(total);
    if let Ok(style) = ProgressStyle::with_template(template) {
        bar.set_style(style);
    }
    bar.enable_steady_tick(Duration::from_millis(500));
    bar
}

/// A number with three significant digits: "0.562", "0.0000100".
pub fn significant(number: f32) -> String {
    let digits = (2.0 - number.abs().log10().floor()).clamp(0.0, 40.0);
    if number == 0.0 { "0".into() } else { format!("{number:.*}", digits as usize) }
}

/// Formats 1234567 as "1,234,567".
pub fn thousands(value: u64) -> String {
    HumanCount(value).to_string()
}

/// Formats seconds as "1:02:03" or "2:03".
pub fn clock(seconds: f64) -> String {
    let total = seconds.clamp(0.0, 3.6e6).round() as u64;
    let (hours, minutes, seconds) = (total / 3600, total / 60 % 60, total % 60);
    if hours > 0 { format!("{hours}:{minutes:02}:{seconds:02}") } else { format!("{minutes}:{seconds:02}") }
}
