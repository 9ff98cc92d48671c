//! `ashsplat train --verify-determinism N`.

use super::checkpoints::ResumePoint;
use super::prepared;
use super::training_start::RunStart;
use ashsplat::train::verify::{Verdict, verify_determinism};
use ashsplat::vk::Context;
use ashsplat::{Error, Result};
use ashsplat_files::Dataset;
use ashsplat_program::config::Settings;

/// Trains some iterations twice, from a checkpoint if there is one, without writing anything. Returns an error if the
/// two differ.
pub fn run(
    context: &Context,
    dataset: Dataset,
    (settings, initial): (&Settings, &RunStart),
    iterations: u32,
    quiet: bool,
) -> Result<()> {
    let start = initial.start();
    let first = initial.initial_gaussians(&dataset, settings)?;
    let (data, _) = prepared::split(dataset, settings);
    let new = |context: &Context| initial.trainer(context, data.clone(), first.clone(), &settings.train);
    let left = settings.train.iterations.saturating_sub(start.map_or(0, ResumePoint::iteration));
    if left == 0 {
        return Err(Error::argument("checkpoint", "is of the last iteration: there is none left to verify"));
    }
    let iterations = iterations.min(left);
    let mut last = 0;
    let report = |run: u32, iteration: u32, hash: u64| {
        last = hash;
        if !quiet {
            errln!("run {} iteration {iteration}: {hash:016x}", run + 1);
        }
    };
    match verify_determinism(|| Ok(context.clone()), new, iterations, report)? {
        Verdict::Same => {
            let device = context.device_name();
            outln!(
                "{iterations} iterations twice on {device}: the same bits after each; hash of the last {last:016x}"
            );
            Ok(())
        }
        Verdict::Differs { iteration, first, problem } => {
            let place = match (first, problem) {
                (_, Some(problem)) => format!("which kernel is the first to differ is not known: {problem}"),
                (Some(first), None) => format!(
                    "the first other output is of kernel {} (command {} of '{}', iteration {}): buffer '{}'",
                    first.record.kernel,
                    first.record.command,
                    first.record.submission,
                    first.iteration,
                    first.record.buffer
                ),
                (None, None) => "command by command they do not: commands race with each other, or the device errs at times"
                    .into(),
            };
            let problem = format!("two runs differ after iteration {iteration}; {place}");
            Err(Error::argument(format!("device '{}'", context.device_name()), problem))
        }
    }
}
