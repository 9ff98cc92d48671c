//! `ashsplat blocks`: progress of each block's training.

use ashsplat::{Error, Result};
use ashsplat_program::args::HostArguments;
use ashsplat_program::blocks::{Block, BlocksFile, Division, result};
use ashsplat_program::lock::{self, TRAINING};
use ashsplat_program::progress::thousands;
use ashsplat_program::session;
use ashsplat_program::train_log::{LOG_FILE, Rows};
use clap::Args;
use serde_json::{Value, json};
use std::path::PathBuf;
use std::time::{Duration, Instant};

/// Show the training progress of each block: iterations, PSNR, iterations per second, memory.
///
/// Read from what the trainings write into their model folders, on whatever machine they run.
#[derive(Args)]
pub struct Arguments {
    /// The file that `ashsplat partition` wrote
    #[arg(value_name = "BLOCKS.json")]
    blocks: PathBuf,
    /// Print it again every N seconds until all blocks are trained
    #[arg(long, value_name = "SECONDS", num_args = 0..=1, default_missing_value = "10", value_parser = clap::value_parser!(u64).range(1..))]
    watch: Option<u64>,
    /// Print JSON
    #[arg(long)]
    json: bool,
    /// Factor by which a block's Gaussians grow during training, for the `memory_bytes` of --json; at most 10 with
    /// --strategy budget
    #[arg(long, value_name = "X", default_value_t = 10.0, requires = "json")]
    growth: f64,
    #[command(flatten)]
    _host: HostArguments,
}

/// Bytes per trained Gaussian with SH degree 3 and `--moments f32`, more than presets take: parameters, moments, statistics.
const TRAINED_BYTES: f64 = 728.0;
/// Bytes per Gaussian that is only drawn: the rest of the scene after an exchange.
const DRAWN_BYTES: f64 = 240.0;
/// Bytes per pixel of a photograph on the device.
const PIXEL_BYTES: f64 = 4.0;
/// Bytes that do not grow with the scene: program, driver, and frames for photographs of ten megapixels.
const OTHER_BYTES: f64 = 1.5e9;

/// Number of last iterations that determine the speed.
const RECENT: usize = 100;
/// Longest delay before Ctrl-C ends waiting.
const GLANCE: Duration = Duration::from_millis(100);

pub fn run(arguments: &Arguments) -> Result<()> {
    let growth = arguments.growth;
    if !(growth.is_finite() && growth >= 1.0) {
        return Err(Error::argument("--growth", format!("is {growth}, must be 1 or more")));
    }
    let file = BlocksFile::read(&arguments.blocks)?;
    let Some(seconds) = arguments.watch else {
        show(&file, arguments);
        return Ok(());
    };
    let stop = session::stop_on_ctrl_c()?;
    while show(&file, arguments) < file.division.blocks.len() {
        let shown = Instant::now();
        while shown.elapsed().as_secs() < seconds {
            session::check(&stop)?;
            std::thread::sleep(GLANCE);
        }
    }
    Ok(())
}

/// Estimated memory of a block's training, bytes, if its Gaussians grow by this factor. On a processor it is the
/// machine's whole memory, on a GPU the device's; the host then needs less.
fn memory_bytes(file: &BlocksFile, block: &Block, growth: f64) -> u64 {
    let Division { coarse, rounds, .. } = &file.division;
    let around = if *rounds > 1 { coarse.gaussians - block.trained.min(coarse.gaussians) } else { 0 };
    let growing = TRAINED_BYTES * block.trained as f64 + DRAWN_BYTES * around as f64;
    (OTHER_BYTES + PIXEL_BYTES * block.pixels as f64 + growing * growth) as u64
}

/// Prints all blocks. Returns the number of trained ones.
fn show(file: &BlocksFile, arguments: &Arguments) -> usize {
    let round = file.exchanges() + 1;
    let all: Vec<Status> = file.division.blocks.iter().map(|block| Status::of(file, block, round)).collect();
    let trained = all.iter().filter(|status| status.state == State::Trained).count();
    if arguments.json {
        let needed = |block| memory_bytes(file, block, arguments.growth);
        let blocks: Vec<Value> = all.iter().map(|status| status.json(needed(status.block))).collect();
        outln!("{:#}", json!({ "blocks": blocks, "trained": trained }));
        return trained;
    }
    for status in &all {
        outln!("{}", status.line());
    }
    outln!("{trained} of {} blocks trained", all.len());
    trained
}

#[derive(Clone, Debug, PartialEq)]
enum State {
    Waiting,
    /// The process that trains it.
    Training(String),
    Stopped,
    /// Ended this round; waits for the exchange.
    Exchange(u32),
    Trained,
    /// Trained for another division.
    Other,
}

/// Progress of one block.
struct Status<'a> {
    block: &'a Block,
    state: State,
    /// Last iteration in its log.
    iteration: u32,
    gaussians: Option<u64>,
    /// Last measured PSNR, dB.
    psnr: Option<f64>,
    iterations_per_second: Option<f64>,
    /// Peak memory on the device.
    peak_bytes: Option<u64>,
}

impl Status<'_> {
    /// `round` is the current round of all blocks.
    fn of<'a>(file: &BlocksFile, block: &'a Block, round: u32) -> Status<'a> {
        let folder = file.at(&block.folder);
        // There is no log before a training begins, or while it is being replaced.
        let rows = Rows::read(&folder.join(LOG_FILE)).unwrap_or_default();
        let last = |column: &[f64]| column.iter().rev().copied().find(|value| value.is_finite());
        let iteration = last(&rows.iterations).unwrap_or(0.0) as u32;
        let waits = file.ended_own(block).is_some_and(|ended| ended.round == round);
        let state = match (result::noted(file, block), lock::holder(&folder, &TRAINING)) {
            (_, Some(holder)) => State::Training(holder),
            (Some(true), None) => State::Trained,
            (Some(false), None) => State::Other,
            (None, None) if waits => State::Exchange(round),
            (None, None) if iteration > 0 => State::Stopped,
            (None, None) => State::Waiting,
        };
        let recent = &rows.milliseconds[rows.milliseconds.len().saturating_sub(RECENT)..];
        let seconds = recent.iter().filter(|ms| ms.is_finite()).sum::<f64>() / 1e3;
        let psnr = last(&rows.tracked_psnr).or_else(|| last(&rows.psnr));
        Status {
            block,
            state,
            iteration,
            gaussians: last(&rows.gaussians).map(|count| count as u64),
            psnr,
            iterations_per_second: (seconds > 0.0).then(|| recent.len() as f64 / seconds),
            peak_bytes: last(&rows.peak_bytes).map(|bytes| bytes as u64),
        }
    }

    fn word(&self) -> &'static str {
        match self.state {
            State::Exchange(_) => "waiting for an exchange",
            State::Waiting => "waiting",
            State::Training(_) => "training",
            State::Stopped => "stopped",
            State::Trained => "trained",
            State::Other => "of another division",
        }
    }

    fn line(&self) -> String {
        let Status { block, iteration, .. } = self;
        let mut line = format!("block {}: {}, {iteration}/{}", block.number, self.word(), block.iterations);
        let mut add = |what: Option<String>| line.extend(what.map(|what| format!(", {what}")));
        if let State::Exchange(round) = self.state {
            add(Some(format!("round {round} done")));
        }
        add(self.psnr.map(|psnr| format!("{psnr:.2} dB")));
        add(self.iterations_per_second.map(|speed| format!("{speed:.1} it/s")));
        add(self.gaussians.map(|count| format!("{} Gaussians", thousands(count))));
        let mebibytes = self.peak_bytes.map(|bytes| bytes >> 20).filter(|&count| count > 0);
        add(mebibytes.map(|count| format!("{count} MiB at most")));
        if let State::Training(holder) = &self.state {
            add(Some(holder.clone()).filter(|holder| !holder.is_empty()));
        }
        line
    }

    fn json(&self, memory_bytes: u64) -> Value {
        let holder = match &self.state {
            State::Training(holder) => Some(holder),
            _ => None,
        };
        json!({
            "number": self.block.number,
            "state": self.word(),
            "iteration": self.iteration,
            "iterations": self.block.iterations,
            "gaussians": self.gaussians,
            "psnr": self.psnr,
            "iterations_per_second": self.iterations_per_second,
            "peak_bytes": self.peak_bytes,
            "trainer": holder,
            "memory_bytes": memory_bytes,
        })
    }
}
