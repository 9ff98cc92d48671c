//! Checks, counts and reports each iteration.

use super::Run;
use ashsplat::train::StepReport;
use ashsplat::{Error, Result};
use ashsplat_files::quoted;
use ashsplat_program::progress::{State, clock, thousands};
use std::collections::BTreeMap;

/// Iterations after which a training without effect is noticed.
const WITHOUT_EFFECT: u32 = 300;
/// Change of a view's loss, as a share of it, that counts as none.
const SAME_LOSS: f32 = 1e-4;
/// Seconds of a run from which a shorter one is proposed.
const LONG_RUN: f64 = 3600.0;
/// Iterations and width of photographs of the shorter run, which takes minutes on a processor.
const SHORT_RUN: (u32, u32) = (600, 400);

/// Notices that training has no effect: no view shows a Gaussian, or no view's loss moves.
#[derive(Default)]
pub struct Effect {
    /// Consecutive iterations without a visible Gaussian.
    empty: u32,
    /// Consecutive iterations in which no view's loss has moved.
    still: u32,
    /// First loss of each view in these iterations.
    losses: BTreeMap<usize, f32>,
    reported: bool,
}

impl Effect {
    /// Counts an iteration of a run of `iterations` with `views`. Returns the warning once.
    fn after(&mut self, report: &StepReport, views: u32, iterations: u32) -> Option<String> {
        if report.skipped || self.reported {
            return None;
        }
        self.empty = if report.visible == 0 { self.empty + 1 } else { 0 };
        let first = *self.losses.entry(report.view).or_insert(report.loss);
        if (report.loss - first).abs() <= SAME_LOSS * first {
            self.still += 1;
        } else {
            self.losses = [(report.view, report.loss)].into();
            self.still = 1;
        }
        let advice = "check the poses, the scale and the points of the data set (`ashsplat info DATASET`)";
        let warning = if self.empty >= WITHOUT_EFFECT.max(views).min(iterations) {
            format!("warning: no view showed a Gaussian in the last {} iterations: {advice}", self.empty)
        } else if self.still >= WITHOUT_EFFECT.max(views.saturating_mul(2)) {
            format!("warning: the loss of no view has moved in the last {} iterations: {advice}", self.still)
        } else {
            return None;
        };
        self.reported = true;
        Some(warning)
    }
}

impl Run {
    /// Ends training with an error if no Gaussians are left.
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

    pub(super) fn account(&mut self, report: &StepReport) {
        self.gaussians = report.gaussians;
        self.non_finite += u64::from(report.skipped_non_finite);
        if report.densified.is_some_and(|densified| densified.limited) && !self.limited {
            self.limited = true;
            let (count, used) =
                (thousands(u64::from(report.gaussians)), self.trainer.context().memory_total().bytes >> 20);
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
        let (views, iterations) = (self.views.trained.len() as u32, self.until - self.started);
        if let Some(warning) = self.effect.after(report, views, iterations) {
            self.progress.warn(&warning);
        }
        self.progress.step(&State {
            iteration: report.iteration,
            loss: report.loss,
            gaussians: report.gaussians,
            memory_bytes: self.trainer.context().memory_total().bytes,
        });
        if let Some(seconds) = self.progress.first_estimate(report.iteration).filter(|s| *s > LONG_RUN) {
            self.progress.note(&self.propose_short_run(seconds));
        }
    }

    fn propose_short_run(&self, seconds: f64) -> String {
        let (iterations, width) = SHORT_RUN;
        let data = &self.settings.data;
        let [dataset, model] =
            [&data.source_path, &data.model_path].map(|path| quoted(&path.to_string_lossy()));
        let is_wide = self.views.test.iter().any(|view| view.camera.width > width);
        let smaller = if is_wide { format!(" -r {width}") } else { String::new() };
        format!(
            "at this speed the training takes {} or longer; a first look in minutes: \
             ashsplat train -s {dataset} -m {model} --eval{smaller} --iterations {iterations}",
            clock(seconds)
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The iterations with a warning. `report` gives visible Gaussians and loss of an iteration; there are two views.
    fn warned(iterations: u32, report: impl Fn(u32) -> (u32, f32)) -> Vec<(u32, String)> {
        let mut effect = Effect::default();
        let mut after = |iteration: u32| {
            let (visible, loss) = report(iteration);
            let view = iteration as usize % 2;
            let report = StepReport { iteration, view, visible, loss, ..StepReport::default() };
            effect.after(&report, 2, iterations)
        };
        (1..=iterations).filter_map(|iteration| Some((iteration, after(iteration)?))).collect()
    }

    #[test]
    fn training_without_effect_is_said_once() {
        let empty = warned(1000, |i| (0, i as f32));
        assert!(
            matches!(&empty[..], [(300, line)] if line.contains("no view showed a Gaussian")),
            "{empty:?}"
        );
        // The whole run, if it is shorter.
        assert_eq!(warned(40, |i| (0, i as f32))[0].0, 40);
        let still = warned(1000, |i| (9, 0.5 + (i % 2) as f32));
        assert!(
            matches!(&still[..], [(300, line)] if line.contains("loss of no view has moved")),
            "{still:?}"
        );
        assert_eq!(warned(1000, |i| (9, 0.5 + 1e-6 * i as f32)), []);
        assert_eq!(warned(1000, |i| (i % 100, 1.0 / i as f32)), []);
    }
}
