//! Work that a strategy requests from training, and reports of steps and of the work between them.

use crate::render::BlendSamples;
use crate::vk::ScopeTime;

/// Work between two steps: a set of up to 32 actions. The strategy interprets them. The two named actions also tell the program
/// whether the scene is complete, so a strategy must use them in their sense.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Actions(pub u32);

impl Actions {
    /// Empty set.
    pub const NONE: Self = Self(0);
    /// A densification.
    pub const DENSIFY: Self = Self(1);
    /// An opacity reset.
    pub const RESET_OPACITY: Self = Self(2);

    /// Returns the union of both sets.
    #[must_use]
    pub const fn and(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    /// Returns the set if the condition holds, otherwise the empty set.
    #[must_use]
    pub const fn when(self, condition: bool) -> Self {
        if condition { self } else { Self::NONE }
    }

    /// Returns the set without the actions of another set.
    #[must_use]
    pub const fn without(self, other: Self) -> Self {
        Self(self.0 & !other.0)
    }

    /// True if all actions of another set are in this one.
    pub const fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }

    /// True if the set is empty.
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// Returns the action with the lowest bit, which comes first.
    #[must_use]
    pub const fn first(self) -> Self {
        Self(self.0 & self.0.wrapping_neg())
    }
}

/// Part of an iteration's work that the strategy decides.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Work {
    /// True if the backward pass adds to the statistics ([`Population::statistics`](super::Population::statistics)).
    pub accumulates: bool,
    /// True if the optimiser makes a step.
    pub optimizes: bool,
    /// True if that step moves the opacities.
    pub optimizes_opacity: bool,
    /// Work before the next iteration.
    pub actions: Actions,
}

/// Outcome of [`Strategy::between_steps`](super::Strategy::between_steps).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Changes {
    /// Change of the set of Gaussians, if any.
    pub densified: Option<Densified>,
    /// True if opacities were reset.
    pub opacities_reset: bool,
}

/// Report of a densification.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Densified {
    /// Number of Gaussians before.
    pub before: u32,
    /// Number of Gaussians that stayed.
    pub kept: u32,
    /// Number of added clones.
    pub cloned: u32,
    /// Number of Gaussians that were replaced by two each.
    pub split: u32,
    /// True if memory or the device's limits were too small. Then only the Gaussians with the largest gradients were cloned or
    /// split, or none were pruned.
    pub limited: bool,
}

impl Densified {
    /// Number of Gaussians afterwards.
    pub fn rows(&self) -> u32 {
        self.kept + self.cloned + 2 * self.split
    }
}

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
