//! Reports of steps and of the work between them.

use super::iteration::IterationPlan;
use super::step_recorder::LossValues;
use super::work::Densified;
use crate::renderer::{BlendSamples, State};
use crate::vk::ScopeTime;

/// Report of a step.
#[derive(Clone, Debug, Default)]
pub struct StepReport {
    /// Iteration, counted from 1.
    pub iteration: u32,
    /// True if the iteration was skipped, because its frame has more visible Gaussians or (tile, Gaussian) instances than the
    /// device or the memory can hold. A skipped iteration changes nothing, and its losses are NaN. See
    /// [`Trainer::step`](super::Trainer::step).
    pub skipped: bool,
    /// Loss before the step: the sum of its terms.
    pub loss: f32,
    /// Mean absolute difference of the colours.
    pub l1: f32,
    /// Mean SSIM.
    pub ssim: f32,
    /// Name and weighted value of each loss term. The first is (1 - λ) L1 + λ (1 - SSIM).
    pub terms: Vec<(&'static str, f32)>,
    /// Number of Gaussians in the step.
    pub gaussians: u32,
    /// Number of visible Gaussians in the step's view.
    pub visible: u32,
    /// Number of (tile, Gaussian) instances in the step's view.
    pub instances: u32,
    /// Number of instances in the longest tile of the step's view.
    pub longest_tile: u32,
    /// Counts of blending samples, if enabled.
    pub samples: BlendSamples,
    /// Number of Gaussians that did not change because their gradient was not finite.
    pub skipped_non_finite: u32,
    /// Wall time of the step; 0 for a recorded step.
    pub milliseconds: f64,
    /// Index of the view.
    pub view: usize,
    /// Report of the densification before the step, if the previous iteration requested one. For recorded steps see
    /// [`Maintenance`](super::Maintenance).
    pub densified: Option<Densified>,
    /// Device time per stage.
    pub scopes: Vec<ScopeTime>,
}

/// Outcome of a recorded step that has finished.
#[derive(Clone, Debug)]
pub enum StepOutcome {
    /// The step was executed.
    Done(StepReport),
    /// The step changed nothing, because its frame or that of an earlier step overflowed.
    /// [`Trainer::maintain`](super::Trainer::maintain) grows the capacity, and the iteration is recorded again.
    Overflowed {
        /// Iteration to repeat.
        iteration: u32,
        /// Number of visible Gaussians that the step needs.
        visible_needed: u32,
        /// Capacity of the step in visible Gaussians.
        visible_capacity: u32,
        /// Number of (tile, Gaussian) instances that the step needs. If visible Gaussians overflowed, counts only those that
        /// fit.
        instances_needed: u32,
        /// Capacity of the step in instances.
        instance_capacity: u32,
    },
}

/// Report of [`Trainer::maintain`](super::Trainer::maintain).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct Maintenance {
    /// Report of the densification, if one was due.
    pub densified: Option<Densified>,
    /// True if opacities were reset.
    pub opacities_reset: bool,
    /// True if the capacity grew after an overflow.
    pub grown: bool,
    /// Iteration that was skipped, because its frame exceeds the largest possible capacity: see
    /// [`Trainer::step`](super::Trainer::step).
    pub skipped: Option<u32>,
}

impl StepReport {
    /// Report of a finished step, without times.
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
