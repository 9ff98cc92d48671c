//! Adaptive density control as a part of training that can be exchanged.
//!
//! A strategy decides what an iteration accumulates, what happens to the set of Gaussians between two steps,
//! what it adds to the parameters and to the loss, and what of it belongs into memory and checkpoint.
//! [`Reference`] is that of Kerbl et al. 2023.

mod fixed;
mod reference;

pub use fixed::Fixed;
pub use reference::Reference;

use super::population::Population;
use super::settings::{StrategyType, TrainSettings};
use crate::error::Result;
use crate::forward::FrameInputs;
use crate::loss::LossTerm;
use crate::optimizer::{Moments, Step};
use crate::vk::{Buffer, Context, Recorder};

/// Work between two steps: a set of up to 32 actions, which only the strategy interprets.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Actions(pub u32);

impl Actions {
    /// No work.
    pub const NONE: Self = Self(0);
    /// A densification.
    pub const DENSIFY: Self = Self(1);
    /// An opacity reset.
    pub const RESET_OPACITY: Self = Self(2);

    /// Both sets.
    #[must_use]
    pub const fn and(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    /// The set if the condition holds, otherwise none.
    #[must_use]
    pub const fn when(self, condition: bool) -> Self {
        if condition { self } else { Self::NONE }
    }

    /// Without the actions of another set.
    #[must_use]
    pub const fn without(self, other: Self) -> Self {
        Self(self.0 & !other.0)
    }

    /// Whether all actions of another set are in this one.
    pub const fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }

    /// Whether there are none.
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// The action that comes first: that of the lowest bit.
    #[must_use]
    pub const fn first(self) -> Self {
        Self(self.0 & self.0.wrapping_neg())
    }
}

/// The part of an iteration's work that the strategy decides.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Work {
    /// Whether the backward pass adds to the gradient statistics ([`StepInputs::statistics`]).
    pub accumulates: bool,
    /// Whether the optimiser makes a step.
    pub optimizes: bool,
    /// Whether that step moves the opacities.
    pub optimizes_opacity: bool,
    /// Work before the next iteration.
    pub actions: Actions,
}

/// The outcome of [`Strategy::between_steps`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Changes {
    /// How the set of Gaussians has changed.
    pub densified: Option<Densified>,
    /// Whether opacities were reset.
    pub opacities_reset: bool,
}

/// The report of a densification.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Densified {
    /// Gaussians before.
    pub before: u32,
    /// Gaussians that stayed.
    pub kept: u32,
    /// Clones that were added.
    pub cloned: u32,
    /// Gaussians that were replaced by two each.
    pub split: u32,
    /// Whether memory or the device's limits did not suffice for all new Gaussians, so that only those with
    /// the largest gradients were cloned or split.
    pub limited: bool,
}

impl Densified {
    /// Gaussians afterwards.
    pub fn rows(&self) -> u32 {
        self.kept + self.cloned + 2 * self.split
    }
}

/// A buffer of a strategy with values per Gaussian: zero at the beginning and after each change of the set.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Statistic {
    /// Its name, in memory reports and in the checkpoint.
    pub name: &'static str,
    /// Floats per Gaussian.
    pub floats: u32,
}

/// The norm of the 2D mean's gradient (NDC) summed over views, and the number of views: what the backward pass
/// accumulates if [`Work::accumulates`] is set. The first of every trainer's statistics.
pub const GRADIENT_STATISTIC: Statistic = Statistic { name: "statistics", floats: 2 };

/// What a strategy records into a step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Hooks {
    /// Whether [`Strategy::record_statistics`] is called.
    pub statistics: bool,
    /// Whether [`Strategy::record_update`] is called, after steps of the optimiser.
    pub update: bool,
}

/// A step on the device, for what a strategy records into it.
#[derive(Clone, Copy)]
pub struct StepInputs<'a> {
    /// The frame; its gradients are `frame.frame.gradients`.
    pub frame: &'a FrameInputs<'a>,
    /// Adam's moments.
    pub moments: &'a Moments,
    /// [`GRADIENT_STATISTIC`], then those of [`Strategy::statistics`].
    pub statistics: &'a [Buffer],
    /// The iteration, from 1.
    pub iteration: u32,
    /// The optimiser's step, with its learning rates.
    pub step: &'a Step,
    /// The run's settings.
    pub settings: &'a TrainSettings,
    /// The scene's extent, world units.
    pub scene_extent: f32,
}

/// A strategy of density control.
///
/// Everything random is keyed by the seed and the iteration, so that a run can be resumed with the same bits.
/// Kernels are built when the strategy is made; recording neither allocates nor waits.
pub trait Strategy: Send {
    /// Its name in messages.
    fn name(&self) -> &'static str;

    /// The work of an iteration, from 1. Depends on its arguments only.
    fn work(&self, settings: &TrainSettings, iteration: u32) -> Work;

    /// Terms that it adds to the loss. Called once.
    ///
    /// # Errors
    /// When the device refuses a pipeline.
    fn loss_terms(&mut self, _: &Context, _: &TrainSettings) -> Result<Vec<Box<dyn LossTerm>>> {
        Ok(Vec::new())
    }

    /// Its statistics, besides [`GRADIENT_STATISTIC`]. The trainer counts and allocates their memory, and
    /// keeps them in the checkpoint.
    fn statistics(&self) -> Vec<Statistic> {
        Vec::new()
    }

    /// Which of the two hooks below it uses: the others cost no barrier.
    fn records(&self) -> Hooks {
        Hooks::default()
    }

    /// Records the update of its own statistics, after the backward pass. A barrier precedes it. It must
    /// change nothing if `state[STATE_OVERFLOW]` is set.
    fn record_statistics(&self, _: &mut Recorder, _: &StepInputs) {}

    /// Records what it adds to the parameters, after the optimiser's step. A barrier precedes it. It must
    /// change nothing if `state[STATE_OVERFLOW]` is set.
    fn record_update(&self, _: &mut Recorder, _: &StepInputs) {}

    /// Does one action of an iteration's [`Work::actions`] before the next iteration, the lowest bit first.
    ///
    /// # Errors
    /// When the device is lost. The population is then as before, or its state is unknown.
    fn between_steps(&mut self, population: &mut Population, action: Actions) -> Result<Changes>;

    /// State on the host that a resumed run needs: names and values.
    fn state(&self) -> Vec<(String, String)> {
        Vec::new()
    }

    /// Restores [`Strategy::state`].
    ///
    /// # Errors
    /// [`Error::Argument`](crate::Error::Argument) for a state that it does not know.
    fn restore(&mut self, state: &[(String, String)]) -> Result<()> {
        match state.first() {
            None => Ok(()),
            Some((name, _)) => {
                let problem = format!("has '{name}', which the strategy '{}' does not know", self.name());
                Err(crate::Error::argument("checkpoint", problem))
            }
        }
    }
}

/// The strategy that the settings name.
///
/// # Errors
/// When the device refuses a pipeline.
pub fn of_settings(context: &Context, settings: &TrainSettings) -> Result<Box<dyn Strategy>> {
    Ok(match settings.strategy {
        StrategyType::Default => Box::new(Reference::new(context)?),
        StrategyType::Fixed => Box::new(Fixed),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn actions_are_done_one_by_one_densification_first() {
        let mut due = Actions::DENSIFY.and(Actions::RESET_OPACITY).and(Actions(1 << 31));
        let mut order = Vec::new();
        while !due.is_empty() {
            order.push(due.first());
            due = due.without(due.first());
        }
        assert_eq!(order, [Actions::DENSIFY, Actions::RESET_OPACITY, Actions(1 << 31)]);
        assert_eq!(Actions::DENSIFY.when(false), Actions::NONE);
        assert!(!Actions::DENSIFY.contains(Actions::RESET_OPACITY));
    }
}
