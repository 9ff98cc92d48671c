//! Schedule of a run: the work of each iteration. It depends on the settings, the seed, the iteration and the progress before
//! it.

use super::needs::Needs;
use super::random::{self, ViewOrder};
use super::run::Run;
use super::settings::{OptimizerType, TrainSettings};
use super::warm_up;
use super::work::{Actions, Work};
use crate::exposure::LightStep;
use crate::forward::RenderSettings;
use crate::optimizer::{MeanStep, Rates, Step, ViewSum};
use crate::poses::PoseStep;
use crate::renderer::State;
use crate::scene::Camera;

/// Progress of a run between two iterations.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Progress {
    /// Number of finished iterations.
    pub iteration: u32,
    /// Number of optimiser steps. Skipped iterations make none, and the strategy can omit some.
    pub steps: u64,
    pub opacity_steps: u64,
    /// Number of views whose gradients were added up since the last step.
    pub summed: u32,
    /// Number of steps in the running mean of the parameters since the set of Gaussians last changed.
    pub averaged: u32,
    /// Work before the next iteration.
    pub due: Actions,
}

impl Progress {
    pub fn after(&self, plan: &IterationPlan) -> Self {
        let Work { optimizes, optimizes_opacity, sums_gradients, actions, .. } = plan.work;
        Self {
            iteration: plan.iteration,
            steps: self.steps + u64::from(optimizes),
            opacity_steps: self.opacity_steps + u64::from(optimizes && optimizes_opacity),
            summed: if optimizes { 0 } else { self.summed + u32::from(sums_gradients) },
            averaged: match plan.mean_step {
                Some(MeanStep::Adds(steps)) => steps,
                Some(MeanStep::Ends) => 0,
                None => self.averaged,
            },
            due: actions,
        }
    }
}

/// The work of an iteration.
#[derive(Clone, Copy, Debug)]
pub(super) struct IterationPlan {
    pub iteration: u32,
    pub view: usize,
    /// Camera that draws the view: its own, or one of a smaller picture.
    pub camera: Camera,
    pub work: Work,
    /// Number of views in the gradient sums before this iteration.
    pub summed: u32,
    pub sh_degree: u32,
    pub settings: RenderSettings,
    pub step: Step,
    /// True if the 3D filter's sizes are recomputed after the step.
    pub computes_filters: bool,
    pub exposure: LightStep,
    /// Step of the lens effects, if they are learned.
    pub lens_step: LightStep,
    /// Averaging step of this iteration, if any.
    pub mean_step: Option<MeanStep>,
    /// Step of the poses, if they are optimised.
    pub pose_step: PoseStep,
}

impl IterationPlan {
    /// Estimates the visible Gaussians and instances of a full-size frame from those of the drawn frame.
    pub fn needs(&self, run: &Run, drawn: &State) -> Needs {
        let (visible, instances) = (drawn.visible_needed, drawn.all_instances());
        let cameras = [&run.cameras[self.view], &self.camera];
        Needs { visible, instances: warm_up::whole_instances(cameras, instances, visible) }
    }

    /// Plan with the optimiser's step and the statistics for the given view, for a recording that never executes.
    pub fn rehearsal(self, view: usize, camera: Camera, sums_gradients: bool) -> Self {
        let work = Work { optimizes: true, accumulates: true, sums_gradients, ..self.work };
        Self { view, camera, work, mean_step: Some(MeanStep::Adds(1)), ..self }
    }
}

/// Makes the plans of iterations.
pub(super) struct Schedule {
    order: ViewOrder,
    /// Render settings of training, without the random parts.
    drawn: RenderSettings,
}

impl Schedule {
    pub fn new(run: &Run, drawn: &RenderSettings) -> Self {
        Self { order: ViewOrder::new(run.settings.seed, run.cameras.len()), drawn: *drawn }
    }

    /// Plan of the next iteration. `work` is the strategy's choice for it.
    pub fn plan_after(&mut self, progress: &Progress, run: &Run, mut work: Work) -> IterationPlan {
        let iteration = progress.iteration + 1;
        let s = &run.settings;
        // The reference's last iteration only saves.
        work.optimizes &= iteration < s.iterations;
        // A step must include the gradients added up before.
        work.sums_gradients = (work.sums_gradients || progress.summed > 0) && iteration < s.iterations;
        // Exposures and poses add up gradients whenever the Gaussians do.
        let sum = match work.sums_gradients {
            true => ViewSum { starts: progress.summed == 0, makes_step: work.optimizes },
            false => ViewSum::ALONE,
        };
        let mean_step = mean_step(s, iteration, progress, &work);
        let view = self.order.view(iteration);
        IterationPlan {
            iteration,
            view,
            camera: s.warm_up_camera(iteration, &run.cameras[view]),
            work,
            summed: progress.summed,
            sh_degree: s.sh_degree_at(iteration),
            settings: RenderSettings {
                background: background(run, iteration),
                dropout: s.dropout_at(iteration),
                ..self.drawn
            },
            step: optimizer_step(run, iteration, progress, &work),
            // Filter sizes depend on the means.
            computes_filters: s.computes_filters_at(iteration)
                || (s.filter_3d && mean_step == Some(MeanStep::Ends)),
            mean_step,
            exposure: LightStep {
                rate: s.exposure_lr(iteration),
                count: progress.steps + 1,
                sum,
                decay: 2.0 * s.exposure_reg,
                sparsity: s.exposure_sparsity,
            },
            lens_step: LightStep {
                rate: s.lens_lr(iteration),
                count: progress.steps + 1,
                sum,
                decay: 2.0 * s.lens_reg,
                sparsity: 0.0,
            },
            // Poses make a step whenever the Gaussians do.
            pose_step: PoseStep { rate: pose_rate(s, iteration), count: progress.steps + 1, sum },
        }
    }
}

/// Log-linear from `pose_lr` at 0 to a hundredth of it at the last iteration.
fn pose_rate(s: &TrainSettings, iteration: u32) -> f64 {
    s.pose_lr * 0.01_f64.powf(f64::from(iteration) / f64::from(s.iterations))
}

/// Averages only consecutive steps, so means of an earlier, shorter run do not count.
fn mean_step(s: &TrainSettings, iteration: u32, progress: &Progress, work: &Work) -> Option<MeanStep> {
    let before = if s.averages_at(iteration - 1) { progress.averaged } else { 0 };
    match s.averages_at(iteration) {
        true => work.optimizes.then_some(MeanStep::Adds(before + 1)),
        false => (iteration == s.iterations && before > 0).then_some(MeanStep::Ends),
    }
}

fn background(run: &Run, iteration: u32) -> [f32; 3] {
    if run.settings.random_background {
        return random::background(run.settings.seed, iteration);
    }
    run.render_settings().background
}

fn optimizer_step(run: &Run, iteration: u32, progress: &Progress, work: &Work) -> Step {
    let s = &run.settings;
    let others = s.rate_factor();
    let rates = Rates {
        mean: s.position_lr(iteration) * f64::from(run.scene_extent),
        opacity: if work.optimizes_opacity { s.opacity_lr * others } else { 0.0 },
        quat: s.rotation_lr,
        log_scale: s.scaling_lr * others,
        sh_dc: s.feature_lr * others,
        sh_rest: s.feature_rest_lr() * others,
    };
    match s.optimizer_type {
        OptimizerType::SparseAdam => Step { rates, count: 0, opacity_count: 0 },
        OptimizerType::Default => {
            Step { rates, count: progress.steps + 1, opacity_count: progress.opacity_steps + 1 }
        }
    }
}
