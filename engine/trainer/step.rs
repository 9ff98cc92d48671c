//! One iteration.

use super::iteration::{IterationPlan, Progress};
use super::population::Population;
use super::step_recorder::StepParts;
use super::work::{Changes, Work};
use super::{StepReport, Trainer};
use crate::error::{Error, Result};
use crate::optimizer::MeanStep;
use crate::renderer::{Failed, Ran, State};

impl Trainer {
    /// Runs one iteration. The iteration is skipped if its frame has more visible Gaussians or instances than the device or the
    /// memory can hold, even without the reserve of Gaussians. It then changes nothing, but counts ([`StepReport::skipped`]).
    ///
    /// # Errors
    /// When memory is short, or no view fits: the Gaussians stay as before the iteration, and the caller may try again. When
    /// the device is lost or too slow ([`Error::DeviceLost`], [`Error::Timeout`]): the state of the Gaussians is unknown, and
    /// every later step is refused; resume from a checkpoint. [`Error::Argument`] while recorded steps are in flight.
    pub fn step(&mut self) -> Result<StepReport> {
        self.state.check_whole()?;
        let result = self.run_iteration();
        self.recording.frame_is_ready = false;
        self.state.note_failure(&result);
        result
    }

    /// Repeats the last iteration of a run that is extended. As in the reference, that iteration did not change the parameters,
    /// but in a longer run it does. Its view gives the same gradients on the same parameters. Its statistics are already added.
    /// An iteration stays skipped, and is skipped if it does not fit here.
    pub(super) fn finish_last_iteration(&mut self) -> Result<()> {
        if self.state.skipped > 0 {
            return Ok(());
        }
        let progress = self.state.progress;
        let before = Progress { iteration: progress.iteration - 1, ..progress };
        let plan = self.plan_after(&before);
        if !plan.work.optimizes && !plan.work.sums_gradients {
            return Ok(());
        }
        let plan = IterationPlan { work: Work { accumulates: false, ..plan.work }, ..plan };
        self.photos.prepare(&self.context, plan.iteration)?;
        match self.run_step(&plan) {
            Err(Failed::TooLittleRoom(why)) => self.skip(&plan, &why.0, why.1)?,
            ran => {
                ran.map_err(Failed::error)?;
                self.state.progress = before.after(&plan);
            }
        }
        self.state.progress.due = progress.due;
        Ok(())
    }

    fn run_iteration(&mut self) -> Result<StepReport> {
        let start = std::time::Instant::now();
        self.check_settled()?;
        let densified = self.catch_up()?.densified;
        let progress = self.state.progress;
        let plan = self.plan_after(&progress);
        self.photos.prepare(&self.context, plan.iteration)?;
        if plan.iteration < self.run.settings.iterations {
            self.photos.prefetch(&self.context)?;
        }
        let mut ran = self.run_step(&plan);
        if let Err(Failed::TooLittleRoom(why)) = &ran
            && self.give_up_reserve(&why.0)?
        {
            ran = self.run_step(&plan);
        }
        let ran = match ran {
            Err(Failed::TooLittleRoom(why)) => {
                let (state, error) = *why;
                self.skip(&plan, &state, error)?;
                let skipped = self.recorder.no_losses();
                return Ok(StepReport {
                    skipped: true,
                    milliseconds: start.elapsed().as_secs_f64() * 1e3,
                    densified,
                    ..StepReport::new(&plan, self.state.model.scene.count, &skipped, &state)
                });
            }
            ran => ran.map_err(Failed::error)?,
        };
        self.state.done(progress.after(&plan), plan.needs(&self.run, &ran.state));
        let losses = self.recorder.read_losses(&self.losses.readback)?;
        Ok(StepReport {
            milliseconds: start.elapsed().as_secs_f64() * 1e3,
            densified,
            scopes: ran.report.scopes,
            ..StepReport::new(&plan, self.state.model.scene.count, &losses, &ran.state)
        })
    }

    /// Computes the sizes of the 3D filter for all Gaussians, if there is one.
    pub(super) fn compute_filters(&self) -> Result<()> {
        match &self.filter {
            Some(filter) => filter.run(&self.context, &self.state.model.scene),
            None => Ok(()),
        }
    }

    /// Plan of the next iteration.
    pub(super) fn plan_after(&mut self, progress: &Progress) -> IterationPlan {
        let work = self.strategy.work(&self.run.settings, progress.iteration + 1);
        self.schedule.plan_after(progress, &self.run, work)
    }

    /// Does the work that the previous iteration left for the time before the next one. The reference tests and saves first, so
    /// between steps the scene is what the reference would save.
    pub(super) fn catch_up(&mut self) -> Result<Changes> {
        let mut done = Changes::default();
        loop {
            let due = self.state.progress.due;
            if due.is_empty() {
                return Ok(done);
            }
            self.mask_outside(due.first())?;
            let mut population = Population {
                context: &self.context,
                run: &self.run,
                rows: &self.rows,
                runner: &mut self.runner,
                pictures: &mut self.pictures,
                model: &mut self.state.model,
                photos: &self.photos,
                poses: self.poses.as_ref(),
                most: &mut self.state.most,
                iteration: self.state.progress.iteration,
                summed: &mut self.state.progress.summed,
            };
            let changes = self.strategy.between_steps(&mut population, due.first())?;
            // The means belong to the previous set of Gaussians.
            self.state.progress.averaged = 0;
            if changes.densified.is_some() {
                self.compute_filters()?;
            }
            done.densified = changes.densified.or(done.densified);
            done.opacities_reset |= changes.opacities_reset;
            self.state.progress.due = due.without(due.first());
        }
    }

    /// Skips an iteration whose frame has too many visible Gaussians or instances for the device or the memory. Densification
    /// adds no Gaussians until frames have fewer.
    ///
    /// # Errors
    /// The given error, if it has another cause, if no step has succeeded yet, or if every view was skipped since the last
    /// successful step. A training without progress must end.
    pub(super) fn skip(&mut self, plan: &IterationPlan, needed: &State, error: Error) -> Result<()> {
        self.skip_parameters(plan, needed, error)?;
        match plan.mean_step {
            Some(MeanStep::Ends) => self.end_means(),
            _ => Ok(()),
        }
    }

    /// Skips the iteration's changes of the parameters.
    fn skip_parameters(&mut self, plan: &IterationPlan, needed: &State, error: Error) -> Result<()> {
        let state = &mut self.state;
        // A view that fits may come first in one epoch and last in the next.
        let apart = 2 * (self.run.cameras.len() as u64 - 1);
        let trains = state.progress.steps > 0 && u64::from(state.skipped) < apart;
        if !matches!(error, Error::TooLarge { .. }) || !trains {
            return Err(error);
        }
        state.skipped += 1;
        state.most = state.most.max(plan.needs(&self.run, needed));
        state.progress = Progress { iteration: plan.iteration, due: plan.work.actions, ..state.progress };
        Ok(())
    }

    /// Runs forward, loss, backward and the optimiser's step in one submission.
    fn run_step(&mut self, plan: &IterationPlan) -> Result<Ran, Failed> {
        self.recorder.prepare_for(plan)?;
        let (run, model, strategy) = (&self.run, &self.state.model, &*self.strategy);
        let (photos, maps, memory) = (&self.photos, &self.maps, &self.losses);
        let (filter, poses) = (self.filter.as_ref(), self.poses.as_ref());
        let parts = StepParts { run, model, photos, maps, memory, strategy, filter, poses, plan };
        self.runner.run(&parts.frame(), |r, inputs| {
            self.recorder.record(r, inputs, &parts, &self.losses.readback);
            Ok(())
        })
    }
}
