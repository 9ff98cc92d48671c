//! Too little of something from the beginning: a training reaches its end, or says in one line why not.

use super::photos;
use crate::program::{Limits, Program};
use crate::siege::{Outcome, Result, Siege, ensure, text};
use crate::training::{self, LONGEST, Training};

/// The last scene fits into a file, and no checkpoint does.
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

/// Photos for which there is no room. The driver is in the same process and ends it where it has too little for itself, so
/// there is enough for that.
pub fn memory(siege: &Siege) -> Result<Outcome> {
    let (folder, model) = (photos::data_of(siege)?, siege.place("refused"));
    let arguments =
        ["train", "-s", text(&folder)?, "-m", text(&model)?, "--iterations=1", "--random-points", "--quiet"];
    for mib in siege.choose(&[3000][..], &[6000, 4000, 3000, 2500]) {
        let limits = Limits { memory: Some(mib << 10), ..Limits::default() };
        let mut program = Program::start(&siege.program, &limits, &siege.peak, &arguments)?;
        let ending = program.end(LONGEST)?;
        ending.check_refused().map_err(|error| format!("{mib} MiB: {error}"))?;
        ensure!(!model.exists(), "the model folder was made all the same");
    }
    Ok(Outcome::Withstood("refused in one line".into()))
}
