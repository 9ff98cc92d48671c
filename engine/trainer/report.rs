//! Reports of steps, and of the work between them.

use super::iteration::IterationPlan;
use super::step_recorder::LossValues;
use super::work::Densified;
use crate::renderer::{BlendSamples, State};
use crate::vk::ScopeTime;

/// The report of a step.
#[derive(Clone, Debug, Default)]
pub struct StepReport {
    /// Iteration, from 1.
    pub iteration: u32,
    /// Whether the iteration was skipped, because its frame has more visible Gaussians or (tile, Gaussian) instances than the
    /// device or the memory can hold. It has changed nothing, and its losses are NaN. See
    /// [`Trainer::step`](super::Trainer::step).
    pub skipped: bool,
    /// The loss before the step: the sum of its terms.
    pub loss: f32,
    /// Mean absolute difference.
    pub l1: f32,
    /// Mean SSIM.
    pub ssim: f32,
    /// The terms of the loss: name and weighted value. The first is (1 - λ) L1 + λ (1 - SSIM).
    pub terms: Vec<(&'static str, f32)>,
    /// Gaussians in the step.
    pub gaussians: u32,
    /// Gaussians visible in the step's view.
    pub visible: u32,
    /// (tile, Gaussian) instances of the step's view.
    pub instances: u32,
    /// Instances of the longest tile of the step's view.
    pub longest_tile: u32,
    /// Samples of blending, if counted.
    pub samples: BlendSamples,
    /// Gaussians that did not change because their gradient was not finite.
    pub skipped_non_finite: u32,
    /// Wall time of the step; 0 for a recorded one.
    pub milliseconds: f64,
    /// Index of the view.
    pub view: usize,
    /// The report of the densification before the step, if the previous iteration requested one. For recorded
    /// steps see [`Maintenance`](super::Maintenance).
    pub densified: Option<Densified>,
    /// Device time per stage.
    pub scopes: Vec<ScopeTime>,
}

/// The outcome of a recorded step that has finished.
#[derive(Clone, Debug)]
pub enum StepOutcome {
    /// The step was executed.
    Done(StepReport),
    /// The step changed nothing, because its frame or that of an earlier step overflowed.
    /// [`Trainer::maintain`](super::Trainer::maintain) grows the capacity. Then its iteration is recorded again.
    Overflowed {
        /// The iteration to be repeated.
        iteration: u32,
        /// Visible Gaussians that the step needs.
        visible_needed: u32,
        /// The step's capacity in visible Gaussians.
        visible_capacity: u32,
        /// (tile, Gaussian) instances that the step needs; those of as many visible Gaussians as the step has, if it needs more.
        instances_needed: u32,
        /// The step's capacity in instances.
        instance_capacity: u32,
    },
}

/// The report of [`Trainer::maintain`](super::Trainer::maintain).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct Maintenance {
    /// The report of the densification, if one was due.
    pub densified: Option<Densified>,
    /// Whether opacities were reset.
    pub opacities_reset: bool,
    /// Whether the capacity has grown after a step that overflowed.
    pub grown: bool,
    /// The skipped iteration, whose frame exceeds the largest possible capacity: see [`Trainer::step`](super::Trainer::step).
    pub skipped: Option<u32>,
}

impl StepReport {
    /// The report of a step that has finished, without times.
    pub(super) fn new(plan: &IterationPlan, gaussians: u32, losses: &LossValues, state: &State) -> Self {
        // The photometric term comes first. Its own numbers are L1 and SSIM.
        let [_, l1, ssim, _] = losses.terms.first().map_or([f32::NAN; 4], |(_, row)| *row);
        Self {
            iteration: plan.iteration,
            loss: losses.total,
            l1,
            ssim,
            terms: losses.terms.iter().map(|(name, row)| (*name, row[0])).collect(),
            gaussians,
            visible: state.visible_needed,
            instances: state.all_instances(),
            longest_tile: state.longest_tile,
            samples: state.samples,
            skipped_non_finite: state.non_finite,
            view: plan.view,
            ..Self::default()
        }
    }
}
