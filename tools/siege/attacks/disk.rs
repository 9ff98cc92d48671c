//! A disk that is full in the middle of a training.

use crate::page::Page;
use crate::program::{Limits, can_mount};
use crate::siege::{Outcome, Result, Siege, ensure};
use crate::training::{self, LONGEST, Training};
use std::fs::File;
use std::io::Write;
use std::os::fd::AsRawFd;
use std::path::{Path, PathBuf};

/// Size of the disk, KiB.
const DISK: u64 = 16 << 10;
/// Iterations while it is full; with them go a test, a save and a checkpoint.
const ITERATIONS: u64 = 60;

/// Full when half of the iterations are done, free again for the last ones.
pub fn full(siege: &Siege) -> Result<Outcome> {
    if !can_mount() {
        return Ok(Outcome::Skipped("no small disk can be mounted here".into()));
    }
    let disk = siege.place("attacked");
    let limits = Limits { disk: Some((disk.clone(), DISK)), ..Limits::default() };
    let mut training = Training::start(siege, &limits, &[])?;
    // Only it sees its disk, and whoever holds a folder of it open, also when it is over.
    let inside = format!("/proc/{}/root{}", training.program.id(), disk.display());
    let held = File::open(inside)?;
    let model = PathBuf::from(format!("/proc/self/fd/{}", held.as_raw_fd()));
    let mut page = training.held()?;
    fill(&model.join("filler"))?;
    let done = train_on(&mut page);
    training.explain(done)?;
    std::fs::remove_file(model.join("filler"))?;
    page.act("resume")?;
    let ending = training.program.end(LONGEST)?;
    ensure!(ending.code == Some(0), "training ended with {ending}");
    let warnings = ending.errors.lines().filter(|line| line.starts_with("warning: ")).count();
    ensure!(warnings > 0, "no word of what could not be saved");
    // Checkpoints that had no room came later, as those of other iterations.
    training::check_with(siege, &model, &training::CHECKPOINTS[3..])?;
    let lines = std::fs::read_to_string(model.join("train_log.csv"))?.lines().count();
    ensure!(lines == 1 + training::ITERATIONS as usize, "the log has {lines} lines");
    Ok(Outcome::Withstood(format!(
        "{ITERATIONS} iterations without room: {warnings} warnings; all saved and same bits at the end"
    )))
}

/// A page is told that nothing could be saved, and training goes on.
fn train_on(page: &mut Page) -> Result<()> {
    page.act("save")?;
    page.wait_for("problem").map_err(|_| "a page is not told that nothing was saved")?;
    let start = page.status()?["iteration"].as_u64().unwrap_or_default();
    for _ in 0..ITERATIONS {
        page.act("step")?;
    }
    page.until(|status| status["iteration"].as_u64() >= Some(start + ITERATIONS)).map(drop)
}

/// Leaves no room.
fn fill(path: &Path) -> Result<()> {
    let mut file = File::create(path)?;
    for size in [64 << 10, 1 << 10, 1] {
        while file.write_all(&vec![0; size]).is_ok() {}
    }
    Ok(())
}
