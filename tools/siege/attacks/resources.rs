//! Too little of a resource, from the start or from the middle of a training: it finishes, or says in one line why not.

use crate::page::Page;
use crate::program::{Limits, can_mount};
use crate::siege::{Result, Siege, ensure};
use crate::training::{self, Training};
use std::fs::File;
use std::io::{Error, ErrorKind, Write};
use std::os::fd::AsRawFd;
use std::path::{Path, PathBuf};

/// Size of the disk, KiB.
const DISK: u64 = 16 << 10;
/// Iterations while the disk is full; they include a test, a save and a checkpoint.
const ITERATIONS: u64 = 60;

/// The disk is full after half of the iterations, and free again for the last ones.
pub fn full(siege: &Siege) -> Result<String> {
    if !can_mount() {
        return Err(Error::new(ErrorKind::Unsupported, "no small disk can be mounted here").into());
    }
    let disk = siege.place("attacked");
    let limits = Limits { disk: Some((disk.clone(), DISK)), ..Limits::default() };
    let mut training = Training::start(siege, &limits)?;
    // Only the program sees its disk. An open folder of it stays readable after the program ends.
    let inside = format!("/proc/{}/root{}", training.program.id(), disk.display());
    let held = File::open(inside)?;
    let model = PathBuf::from(format!("/proc/self/fd/{}", held.as_raw_fd()));
    let mut page = training.held()?;
    fill(&model.join("filler"))?;
    let done = train_on(&mut page);
    training.explain(done)?;
    std::fs::remove_file(model.join("filler"))?;
    page.act("resume")?;
    let errors = training.end()?;
    let warnings = errors.lines().filter(|line| line.starts_with("warning: ")).count();
    ensure!(warnings > 0, "no word of what could not be saved");
    // Checkpoints that did not fit were written later, at other iterations.
    training::check_result(siege, &model, &training::CHECKPOINTS[3..])?;
    let lines = std::fs::read_to_string(model.join("train_log.csv"))?.lines().count();
    ensure!(lines == 1 + training::ITERATIONS as usize, "the log has {lines} lines");
    Ok(format!(
        "{ITERATIONS} iterations without room: {warnings} warnings; all saved and same bits at the end"
    ))
}

/// The page gets a message that saving failed, and training continues.
fn train_on(page: &mut Page) -> Result<()> {
    page.act("save")?;
    page.wait_for("problem").map_err(|_| "a page is not told that nothing was saved")?;
    let start = page.status()?["iteration"].as_u64().unwrap_or_default();
    for _ in 0..ITERATIONS {
        page.act("step")?;
    }
    page.until(|status| status["iteration"].as_u64() >= Some(start + ITERATIONS)).map(drop)
}

fn fill(path: &Path) -> Result<()> {
    let mut file = File::create(path)?;
    for size in [64 << 10, 1 << 10, 1] {
        while file.write_all(&vec![0; size]).is_ok() {}
    }
    Ok(())
}

pub fn descriptors(siege: &Siege) -> Result<String> {
    let limits = Limits { descriptors: Some(40), ..Limits::default() };
    let mut training = Training::start(siege, &limits)?;
    let held = training.held().and_then(|mut page| page.act("resume").map(|()| page));
    let _page = training.explain(held)?;
    training.check_end(siege)?;
    Ok("a page looks on; same bits at the end".into())
}
