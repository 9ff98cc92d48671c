//! Too little of a resource from the start: a training finishes, or says in one line why not.

use crate::data;
use crate::program::{Limits, Program};
use crate::siege::{Outcome, Result, Siege, ensure, text};
use crate::training::{self, LONGEST, Training};

/// The final scene fits into a file; checkpoints do not.
pub fn file_size(siege: &Siege) -> Result<Outcome> {
    let scene = training::undisturbed(siege)?;
    let most = (scene.len() as u64 >> 10) + 8;
    let limits = Limits { file: Some(most), ..Limits::default() };
    let mut training = Training::start(siege, &limits, &[])?;
    let ending = training.program.end(LONGEST)?;
    ending.check_refused()?;
    let result = std::fs::read(training::result_of(&training.model));
    ensure!(result.is_ok_and(|result| result == scene), "no last scene, or other bits");
    Ok(Outcome::Withstood(format!("{most} KiB: the last scene is whole, and one error names the checkpoint")))
}

pub fn descriptors(siege: &Siege) -> Result<Outcome> {
    let limits = Limits { descriptors: Some(40), ..Limits::default() };
    let mut training = Training::start(siege, &limits, &[])?;
    let held = training.held().and_then(|mut page| page.act("resume").map(|()| page));
    let _page = training.explain(held)?;
    training.check_end(siege)?;
    Ok(Outcome::Withstood("a page looks on; same bits at the end".into()))
}

/// A scene larger than the memory limit; its bytes are zeros that take no disk space.
pub fn memory(siege: &Siege) -> Result<Outcome> {
    const GAUSSIANS: u64 = 10_000_000;
    const FEW: u64 = 200_000;
    let path = siege.place("large.ply");
    let header = data::ply_header(GAUSSIANS);
    std::fs::write(&path, &header)?;
    let bytes = header.len() as u64 + GAUSSIANS * data::PLY_BYTES;
    std::fs::OpenOptions::new().write(true).open(&path)?.set_len(bytes)?;
    // Decimation takes several times the memory of its Gaussians.
    let (few, fewer) = (siege.place("few.ply"), siege.place("fewer.ply"));
    let header = data::ply_header(FEW);
    std::fs::write(&few, &header)?;
    let length = header.len() as u64 + FEW * data::PLY_BYTES;
    std::fs::OpenOptions::new().write(true).open(&few)?.set_len(length)?;
    let limits = Limits { memory: Some(250 << 10), ..Limits::default() };
    let arguments = ["convert", text(&few)?, text(&fewer)?, "--decimate", "50%"];
    let ending = Program::start(&siege.program, &limits, &siege.peak, &arguments)?.end(LONGEST)?;
    ending.check_refused()?;
    ensure!(ending.errors.contains("bytes of host memory"), "{ending}");
    let (bytes, limit) = (bytes >> 20, 400);
    let limits = Limits { memory: Some(limit << 10), ..Limits::default() };
    let arguments = ["info", text(&path)?];
    let mut program = Program::start(&siege.program, &limits, &siege.peak, &arguments)?;
    program.end(LONGEST)?.check_refused()?;
    Ok(Outcome::Withstood(format!("a scene of {bytes} MiB with {limit}: refused in one line")))
}
