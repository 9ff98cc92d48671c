//! Rounds of a block's training: its start, and its stop for an exchange with the neighbours.

use super::Run;
use super::checkpoints::{StartFrom, newest_iteration};
use ashsplat::{Error, Result};
use ashsplat_program::blocks::job::Job;
use ashsplat_program::blocks::result;
use ashsplat_program::blocks::rounds::{CurrentRound, note};
use ashsplat_program::config::Settings;
use std::path::Path;

/// The start of a round: after an exchange, the exchanged checkpoint until a newer one exists.
pub fn start(given: Option<&StartFrom>, round: Option<&CurrentRound>, folder: &Path) -> Option<StartFrom> {
    let exchanged = round.and_then(|round| Some((round.exchanged(folder)?, round.from)));
    match (given, exchanged) {
        (Some(StartFrom::File(_)), _) | (_, None) => given.cloned(),
        (Some(_), Some((_, from))) if newest_iteration(folder) > Some(from) => given.cloned(),
        (_, Some((exchanged, _))) => Some(StartFrom::Exchanged(exchanged)),
    }
}

/// The current round of a job, if there is one. With rounds, refuses a number of iterations that differs from the division's.
pub fn current_round(job: Option<&Job>, settings: &Settings) -> Result<Option<CurrentRound>> {
    let Some(job) = job else { return Ok(None) };
    let round = CurrentRound::of(job);
    let (own, given) = (job.block().iterations, settings.train.iterations);
    if round.rounds > 1 && own != given {
        let problem = format!(
            "{given} given, but all blocks end their rounds at a share of the division's ({own} here)"
        );
        return Err(Error::argument("--iterations", problem + ": leave it out, or divide again"));
    }
    let train = &settings.train;
    for (name, is_on) in [("pose_opt", train.pose_opt), ("lens_opt", train.lens_opt)] {
        if round.rounds > 1 && is_on {
            let problem = "does not go together with rounds: each block would move its cameras by itself";
            return Err(Error::argument(name, problem));
        }
    }
    Ok(Some(round))
}

impl Run {
    /// Notes that a block's training, or its round, has ended.
    pub(super) fn note_end(&self, job: &Job, round: &CurrentRound) -> Result<()> {
        let data = &self.settings.data;
        if round.is_last() {
            return result::note(job, &data.model_path, self.settings.train.iterations);
        }
        note(job, &data.model_path, round)?;
        round.print_done();
        Ok(())
    }

    /// Stops training at the end of a round, unless it is the last.
    pub(super) fn stop_at_end_of(&mut self, round: &CurrentRound) {
        self.is_in_rounds = round.rounds > 1;
        if !round.is_last() {
            self.until = round.until;
        }
    }

    /// True if a round that is not the last ends after this iteration.
    pub(super) fn ends_round(&self, iteration: u32) -> bool {
        iteration == self.until && self.until < self.settings.train.iterations
    }
}
