//! The log of a training run: a line of CSV per iteration, written during training.

use crate::output;
use ashsplat::train::StepReport;
use ashsplat::vk::ArenaMemory;
use ashsplat::{Error, Result};
use ashsplat_files::regular_file;
use std::fs::File;
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};

/// The arenas of a training, logged with their resident and peak bytes.
const ARENAS: [&str; 9] =
    ["total", "scene", "moments", "scratch", "statistics", "frame", "loss", "photos", "densify"];
const COLUMNS: &str = "iteration,loss,psnr,gaussians,ms,skipped";
/// Column of the mean PSNR over the tracked views.
const TRACKED: &str = "tracked_psnr";
pub const LOG_FILE: &str = "train_log.csv";
/// Largest number of lines that wait in memory.
const FLUSH_INTERVAL: u32 = 100;
/// Most bytes of lines that wait in memory while the disk is full: some ten thousand lines. Beyond it the log ends, because a gap
/// would mislead.
const MAX_WAITING: usize = 16 << 20;

/// A log that is being written. Lines that cannot be written wait and are tried again, so that training continues.
pub struct TrainLog {
    path: PathBuf,
    file: File,
    waiting: Vec<u8>,
    /// True once too much has waited.
    ended: bool,
}

impl TrainLog {
    /// Starts the log and replaces that of an earlier run.
    pub fn create(path: &Path) -> Result<TrainLog> {
        check(path)?;
        let file = File::create(path).map_err(|e| Error::io(path, "create", e))?;
        let mut log = TrainLog::of(path, file);
        let arenas: String =
            ARENAS.iter().map(|arena| format!(",{arena}_bytes,{arena}_peak_bytes")).collect();
        log.line(&format!("{COLUMNS}{arenas},{TRACKED}"));
        log.flush();
        Ok(log)
    }

    /// Continues the log of a run from a checkpoint, and removes the lines after its iteration.
    pub fn resume(path: &Path, iteration: u32) -> Result<TrainLog> {
        check(path)?;
        let Ok(text) = read(path) else { return TrainLog::create(path) };
        let mut lines = text.split_inclusive('\n');
        let Some(header) = lines.next() else { return TrainLog::create(path) };
        let done = |line: &&str| {
            let number = line.split(',').next().and_then(|number| number.parse::<u32>().ok());
            line.ends_with('\n') && number.is_some_and(|number| number <= iteration)
        };
        let kept = format!("{}\n{}", header.trim_end(), lines.filter(done).collect::<String>());
        output::write_text(path, &kept)?;
        let file = File::options().append(true).open(path).map_err(|e| Error::io(path, "write", e))?;
        Ok(TrainLog::of(path, file))
    }

    fn of(path: &Path, file: File) -> TrainLog {
        TrainLog { path: path.to_owned(), file, waiting: Vec::new(), ended: false }
    }

    /// Adds an iteration with the memory of the arenas, and with the PSNR of all views and of the tracked ones, dB, if
    /// they were measured.
    pub fn add(
        &mut self,
        report: &StepReport,
        (tested, tracked): (Option<f64>, Option<f64>),
        memory: &[ArenaMemory],
    ) {
        let [psnr, tracked_psnr] = [tested, tracked].map(|psnr| {
            psnr.filter(|psnr| !psnr.is_nan()).map_or_else(String::new, |psnr| format!("{psnr:.4}"))
        });
        let StepReport { iteration, loss, gaussians, milliseconds, skipped_non_finite, .. } = report;
        let mut line =
            format!("{iteration},{loss},{psnr},{gaussians},{milliseconds:.2},{skipped_non_finite}");
        for arena in ARENAS {
            let arena = memory.iter().find(|m| m.name == arena);
            let (now, peak) = arena.map_or((0, 0), |arena| (arena.bytes, arena.peak_bytes));
            line.push_str(&format!(",{now},{peak}"));
        }
        line.push_str(&format!(",{tracked_psnr}"));
        self.line(&line);
        if tested.is_some() || iteration.is_multiple_of(FLUSH_INTERVAL) {
            self.flush();
        }
    }

    fn line(&mut self, line: &str) {
        self.ended |= self.waiting.len() + line.len() >= MAX_WAITING;
        if !self.ended {
            self.waiting.extend(line.bytes().chain([b'\n']));
        }
    }

    /// Writes the waiting lines, as far as possible.
    pub fn flush(&mut self) {
        // [`TrainLog::finish`] reports the error.
        self.write().ok();
    }

    fn write(&mut self) -> std::io::Result<()> {
        while !self.waiting.is_empty() {
            match self.file.write(&self.waiting) {
                Ok(0) => return Err(ErrorKind::WriteZero.into()),
                Ok(bytes) => drop(self.waiting.drain(..bytes)),
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
        match self.ended {
            true => Err(ErrorKind::StorageFull.into()),
            false => Ok(()),
        }
    }

    /// Writes the waiting lines; returns an error if that fails.
    pub fn finish(&mut self) -> Result<()> {
        self.write().map_err(|e| Error::io(&self.path, "write", e))
    }
}

/// Refuses a pipe in the log's place: opening it might wait forever for its other end.
fn check(path: &Path) -> Result<()> {
    let Ok(found) = std::fs::metadata(path) else { return Ok(()) };
    #[cfg(unix)]
    let waits = {
        use std::os::unix::fs::FileTypeExt;
        let kind = found.file_type();
        kind.is_fifo() || kind.is_socket()
    };
    #[cfg(not(unix))]
    let waits = false;
    match waits || found.is_dir() {
        true => Err(Error::input(path, "is no regular file", "the training's log goes there: remove it")),
        false => Ok(()),
    }
}

fn read(path: &Path) -> Result<String> {
    String::from_utf8(regular_file::read(path, 2)?).map_err(|_| Error::input(path, "is not text", ""))
}

/// The log as columns; NaN for missing numbers.
#[derive(Default)]
pub struct Rows {
    pub iterations: Vec<f64>,
    pub loss: Vec<f64>,
    pub psnr: Vec<f64>,
    pub tracked_psnr: Vec<f64>,
    pub gaussians: Vec<f64>,
    pub milliseconds: Vec<f64>,
    pub peak_bytes: Vec<f64>,
}

impl Rows {
    /// Reads the log on disk, including the runs before a checkpoint.
    pub fn read(path: &Path) -> Result<Rows> {
        let text = read(path)?;
        let mut lines = text.lines();
        let names: Vec<&str> = lines.next().unwrap_or_default().split(',').collect();
        let column = |requested: &str| names.iter().position(|name| *name == requested).unwrap_or(usize::MAX);
        let [iteration, loss, psnr, gaussians, ms, peak, tracked] =
            ["iteration", "loss", "psnr", "gaussians", "ms", "total_peak_bytes", TRACKED].map(column);
        let mut rows = Rows::default();
        for line in lines {
            let fields: Vec<&str> = line.split(',').collect();
            let number = |at: usize| fields.get(at).and_then(|f| f.parse().ok()).unwrap_or(f64::NAN);
            rows.iterations.push(number(iteration));
            rows.loss.push(number(loss));
            rows.psnr.push(number(psnr));
            rows.tracked_psnr.push(number(tracked));
            rows.gaussians.push(number(gaussians));
            rows.milliseconds.push(number(ms));
            rows.peak_bytes.push(number(peak));
        }
        Ok(rows)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// /dev/full refuses every write.
    #[cfg(target_os = "linux")]
    #[test]
    fn a_failure_is_told_at_the_end() {
        let report = |iteration| StepReport { iteration, ..Default::default() };
        let mut log = TrainLog::create(Path::new("/dev/full")).expect("opened");
        log.add(&report(1), (Some(20.0), None), &[]);
        let error = log.finish().expect_err("nothing can be written").to_string();
        assert!(error.contains("/dev/full: cannot write"), "{error}");
        // Once there is space again, nothing is missing.
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("log.csv");
        log.file = File::create(&path).expect("created");
        log.add(&report(2), (None, None), &[]);
        log.finish().expect("written");
        assert_eq!(Rows::read(&path).expect("the log").iterations, [1.0, 2.0]);
    }

    #[test]
    fn what_waits_is_bounded() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let mut log = TrainLog::create(&folder.path().join("log.csv")).expect("opened");
        let line = "1".repeat(MAX_WAITING / 4);
        (0..10).for_each(|_| log.line(&line));
        assert!(log.waiting.len() < MAX_WAITING);
        log.finish().expect_err("there is a gap");
    }
}
