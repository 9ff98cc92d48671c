//! Verifies determinism: the same inputs must give the same bits.

use super::trainer::Trainer;
use crate::error::Result;
use crate::vk::{AuditRecord, Context};

/// Outcome of training twice.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// The same bits after every iteration.
    Same,
    /// The bits differ.
    Differs {
        /// First iteration after which parameters, moments, statistics or the loss differ.
        iteration: u32,
        /// First command with a different output, if both runs differ again when repeated command by command. None if they do
        /// not: then commands race with each other, or the driver sometimes computes wrongly.
        first: Option<Difference>,
        /// Reason why the search for that command failed: repeating both runs needs more memory.
        problem: Option<String>,
    },
}

/// A command with a different output in the second run.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Difference {
    /// Iteration of the command.
    pub iteration: u32,
    /// Output of the command in the first run.
    pub record: AuditRecord,
}

/// Trains twice for some iterations, each time with a new context and trainer, and compares hashes of the state after every
/// iteration. If they differ, both runs are repeated up to there with an [audit](Context::audit), to find the first command
/// with a different output. `report` receives (run from 0, iteration, hash).
///
/// # Errors
/// Errors of the closures or of a step, except those of the repetition.
pub fn verify_determinism(
    mut context: impl FnMut() -> Result<Context>,
    mut trainer: impl FnMut(&Context) -> Result<Trainer>,
    iterations: u32,
    mut report: impl FnMut(u32, u32, u64),
) -> Result<Verdict> {
    let mut runs: [Vec<(u32, u64, u32)>; 2] = Default::default();
    for (number, run) in (0..).zip(&mut runs) {
        let mut trainer = trainer(&context()?)?;
        for _ in 0..iterations {
            let step = trainer.step()?;
            let hash = trainer.checkpoint()?.fingerprint();
            report(number, step.iteration, hash);
            run.push((step.iteration, hash, step.loss.to_bits()));
        }
    }
    let [first, second] = &runs;
    let Some(place) = first.iter().zip(second).position(|(a, b)| a != b) else { return Ok(Verdict::Same) };
    let iteration = first[place].0;
    let mut audited = || audited_run(&context()?, &mut trainer, place as u32 + 1);
    let (first, second) = match audited().and_then(|first| Ok((first, audited()?))) {
        Ok(both) => both,
        // The difference is known even without the repetition.
        Err(error) => {
            return Ok(Verdict::Differs { iteration, first: None, problem: Some(error.to_string()) });
        }
    };
    let differing = first.into_iter().zip(second).find(|((_, a), (_, b))| a != b);
    let first = differing.map(|((iteration, record), _)| Difference { iteration, record });
    Ok(Verdict::Differs { iteration, first, problem: None })
}

/// All outputs with their iterations (0: before the first).
fn audited_run(
    context: &Context,
    trainer: &mut impl FnMut(&Context) -> Result<Trainer>,
    iterations: u32,
) -> Result<Vec<(u32, AuditRecord)>> {
    let audit = context.audit();
    let mut trainer = trainer(context)?;
    let mut all: Vec<(u32, AuditRecord)> = audit.take().into_iter().map(|record| (0, record)).collect();
    for _ in 0..iterations {
        let step = trainer.step()?;
        all.extend(audit.take().into_iter().map(|record| (step.iteration, record)));
    }
    Ok(all)
}
