//! Rounds of a block's training: where it begins, and where it stops for an exchange with its neighbours.

use super::Run;
use super::checkpoints::{StartFrom, newest_iteration};
use crate::blocks::job::Job;
use crate::blocks::result;
use crate::blocks::rounds::{Stage, note};
use crate::config::Settings;
use ashsplat::{Error, Result};
use std::path::Path;

/// Where a round goes on from: after an exchange from what that has made, until there is a newer checkpoint.
pub fn start(given: Option<&StartFrom>, stage: Option<&Stage>, folder: &Path) -> Option<StartFrom> {
    let exchanged = stage.and_then(|stage| Some((stage.exchanged(folder)?, stage.from)));
    match (given, exchanged) {
        (Some(StartFrom::File(_)), _) | (_, None) => given.cloned(),
        (Some(_), Some((_, from))) if newest_iteration(folder) > Some(from) => given.cloned(),
        (_, Some((exchanged, _))) => Some(StartFrom::Exchanged(exchanged)),
    }
}

/// The stage of a job, if there is one; refuses other iterations than the division's where blocks are to be exchanged at a share of them.
pub fn stage(job: Option<&Job>, settings: &Settings) -> Result<Option<Stage>> {
    let Some(job) = job else { return Ok(None) };
    let stage = Stage::of(job);
    let (own, given) = (job.block().iterations, settings.train.iterations);
    if stage.rounds > 1 && own != given {
        let problem = format!(
            "{given} given, but all blocks end their rounds at a share of the division's ({own} here)"
        );
        return Err(Error::argument("--iterations", problem + ": leave it out, or divide again"));
    }
    if stage.rounds > 1 && settings.train.pose_opt {
        let problem = "does not go together with rounds: each block would move its cameras by itself";
        return Err(Error::argument("pose_opt", problem));
    }
    Ok(Some(stage))
}

impl Run {
    /// Notes that a block's training is at its end, or at that of a round.
    pub(super) fn note_end(&self, job: &Job, stage: &Stage) -> Result<()> {
        let data = &self.settings.data;
        if stage.is_last() {
            return result::note(job, &data.model_path, self.settings.train.iterations);
        }
        note(job, &data.model_path, stage)?;
        stage.say_done();
        Ok(())
    }

    /// Stops where a round does that is not the last.
    pub(super) fn stop_at_end_of(&mut self, stage: &Stage) {
        self.is_in_rounds = stage.rounds > 1;
        if !stage.is_last() {
            self.until = stage.until;
        }
    }

    /// Whether a round ends after an iteration, which is not the last of all.
    pub(super) fn ends_round(&self, iteration: u32) -> bool {
        iteration == self.until && self.until < self.settings.train.iterations
    }
}
