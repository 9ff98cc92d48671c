//! The log of a training run: a line of CSV per iteration, written while training runs.

use ashsplat::trainer::StepReport;
use ashsplat::{Error, Result};
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

/// At most so many lines wait in memory.
const FLUSH_INTERVAL: u32 = 100;

/// A log that is being written. What goes wrong is kept for the end: a log is no reason to stop training.
pub struct TrainLog {
    path: PathBuf,
    file: BufWriter<File>,
    failure: Option<std::io::Error>,
}

impl TrainLog {
    /// Starts the log; one of an earlier run is replaced.
    pub fn create(path: &Path) -> Result<TrainLog> {
        let file = File::create(path).map_err(|e| Error::io(path, "create", e))?;
        let mut log = TrainLog { path: path.to_owned(), file: BufWriter::new(file), failure: None };
        log.attempt(|file| {
            writeln!(file, "iteration,loss,psnr,gaussians,ms,skipped").and_then(|()| file.flush())
        });
        Ok(log)
    }

    /// Adds an iteration, with its PSNR where it was tested, dB.
    pub fn add(&mut self, report: &StepReport, psnr: Option<f64>) {
        let tested = psnr.is_some();
        let psnr = psnr.map_or_else(String::new, |psnr| format!("{psnr:.4}"));
        let StepReport { iteration, loss, gaussians, milliseconds, skipped_non_finite, .. } = report;
        self.attempt(|file| {
            writeln!(file, "{iteration},{loss},{psnr},{gaussians},{milliseconds:.2},{skipped_non_finite}")?;
            if tested || iteration.is_multiple_of(FLUSH_INTERVAL) { file.flush() } else { Ok(()) }
        });
    }

    /// Writes what still waits; the first thing that went wrong since the start is told now.
    pub fn finish(&mut self) -> Result<()> {
        self.attempt(|file| file.flush());
        self.failure.take().map_or(Ok(()), |e| Err(Error::io(&self.path, "write", e)))
    }

    /// After a failure nothing more is written: a log with a gap would mislead.
    fn attempt(&mut self, write: impl FnOnce(&mut BufWriter<File>) -> std::io::Result<()>) {
        if self.failure.is_none() {
            self.failure = write(&mut self.file).err();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn report(iteration: u32) -> StepReport {
        StepReport { iteration, loss: 0.5, gaussians: 7, milliseconds: 1.25, ..Default::default() }
    }

    #[test]
    fn lines_are_on_disk_while_training_runs() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("log.csv");
        let lines = || std::fs::read_to_string(&path).expect("the log").lines().count() as u32;
        let mut log = TrainLog::create(&path).expect("created");
        assert_eq!(lines(), 1);
        for iteration in 1..=FLUSH_INTERVAL {
            log.add(&report(iteration), None);
        }
        assert_eq!(lines(), 1 + FLUSH_INTERVAL);
        log.add(&report(FLUSH_INTERVAL + 1), Some(20.0));
        assert_eq!(lines(), 2 + FLUSH_INTERVAL);
        log.add(&report(FLUSH_INTERVAL + 2), None);
        log.finish().expect("written");
        let text = std::fs::read_to_string(&path).expect("the log");
        assert!(text.ends_with("101,0.5,20.0000,7,1.25,0\n102,0.5,,7,1.25,0\n"), "{text}");
    }

    /// The device that is always full.
    #[cfg(target_os = "linux")]
    #[test]
    fn a_failure_is_told_at_the_end() {
        let mut log = TrainLog::create(Path::new("/dev/full")).expect("opened");
        log.add(&report(1), Some(20.0));
        let error = log.finish().expect_err("nothing can be written").to_string();
        assert!(error.contains("/dev/full: cannot write"), "{error}");
    }
}
