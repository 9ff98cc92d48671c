//! What is checked, counted and said after each iteration.

use super::Run;
use crate::progress::{State, thousands};
use ashsplat::trainer::StepReport;
use ashsplat::{Error, Result};

impl Run {
    /// An iteration over nothing is the last.
    pub(super) fn check(&self, report: &StepReport) -> Result<()> {
        if report.gaussians > 0 {
            return Ok(());
        }
        let problem = format!(
            "pruning left no Gaussians for iteration {}; lower --min-opacity (it is {}) or densify later",
            report.iteration, self.settings.train.min_opacity
        );
        Err(Error::argument("training", problem))
    }

    /// Counts and shows an iteration.
    pub(super) fn account(&mut self, report: &StepReport) {
        self.gaussians = report.gaussians;
        self.non_finite += u64::from(report.skipped_non_finite);
        if report.densified.is_some_and(|densified| densified.limited) && !self.limited {
            self.limited = true;
            let (count, used) = (thousands(u64::from(report.gaussians)), self.trainer.memory_bytes() >> 20);
            self.progress.warn(&format!(
                "warning: iteration {}: no room for all that densification would change of {count} Gaussians \
                 ({used} MiB in use, or the device's limits): those with the largest gradients are added, as far as \
                 they fit, and a pruning is left out",
                report.iteration
            ));
        }
        if report.skipped {
            if self.skipped == 0 {
                self.progress.warn(&format!(
                    "warning: iteration {} is left out: its frame has {} visible Gaussians and {} (tile, Gaussian) instances, \
                     more than the device's limits or the memory hold; densification adds nothing until there are fewer. \
                     More --max-memory, smaller photos (-r 2) or a higher --densify-grad-threshold help",
                    report.iteration,
                    thousands(report.visible.into()),
                    thousands(report.instances.into())
                ));
            }
            self.skipped += 1;
        }
        self.progress.step(&State {
            iteration: report.iteration,
            loss: report.loss,
            gaussians: report.gaussians,
            memory_bytes: self.trainer.memory_bytes(),
        });
    }
}
