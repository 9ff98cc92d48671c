//! Adaptive density control as a replaceable part of training.
//!
//! A strategy decides what an iteration accumulates, how the set of Gaussians changes between two steps, and what it adds to
//! the parameters. It declares its part of the checkpoint. [`Reference`] is the strategy of Kerbl et al. 2023.

mod budget;
mod mcmc;
mod rebuild;
mod reference;

pub use budget::{Budget, GrowthSchedule, QuantilePlace};
pub use mcmc::Mcmc;
pub use reference::Reference;

pub use super::schedule::{Actions, StepWork};

use super::population::Population;
use super::settings::{StrategyType, TrainSettings};
use crate::error::{Error, Result};
use crate::frame::FrameInputs;
use crate::passes::adam::{Moments, Step};
use crate::vk::{Context, Recorder};

/// Outcome of [`Strategy::between_steps`].
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

/// Inputs of a step for a strategy's recordings.
#[derive(Clone, Copy)]
pub struct StepInputs<'a> {
    /// Frame of the step. Its gradients are `frame.buffers.gradients`.
    pub frame: &'a FrameInputs<'a>,
    /// Adam's moments.
    pub moments: &'a Moments,
    /// Iteration, counted from 1.
    pub iteration: u32,
    /// Step of the optimiser, with its learning rates.
    pub step: &'a Step,
    /// Settings of the run.
    pub settings: &'a TrainSettings,
    /// Extent of the scene, world units.
    pub scene_extent: f32,
}

/// A strategy of density control.
///
/// The seed and the iteration key all random numbers, so that a resumed run has the same bits. Kernels are built when the
/// strategy is created, or between two steps; recording neither allocates nor waits. The planes of the Gaussians may lie in
/// other buffers, with another [`ScenePlan`](crate::frame::ScenePlan), in each step.
pub trait Strategy: Send {
    /// Name in messages.
    fn name(&self) -> &'static str;

    /// Checks that a training with these settings can begin with `_gaussians` Gaussians.
    ///
    /// # Errors
    /// [`Error::Argument`] with the allowed values.
    fn check(&self, _: &TrainSettings, _gaussians: u32) -> Result<()> {
        Ok(())
    }

    /// Work of an iteration, counted from 1. Depends only on its arguments.
    fn work(&self, settings: &TrainSettings, iteration: u32) -> StepWork;

    /// True if [`Population::statistics`] sums norms of absolute gradients.
    fn absolute_gradients(&self) -> bool {
        false
    }

    /// True if the strategy selects the Gaussians that it adds by [`Population::statistics`]. In training of a
    /// [block](super::SceneBlock) Gaussians outside the core are then below every threshold.
    fn grows_by_statistics(&self) -> bool {
        true
    }

    /// Records the strategy's changes of the parameters, after the optimiser's step and behind a barrier of its own. It must
    /// change nothing if `state[STATE_OVERFLOW]` is set.
    fn record_update(&self, _: &mut Recorder, _: &StepInputs) {}

    /// Does one action of an iteration's [`StepWork::actions`] before the next iteration, the lowest bit first.
    ///
    /// # Errors
    /// When the device is lost. The population is then unchanged, or its state is unknown.
    fn between_steps(&mut self, population: &mut Population, action: Actions) -> Result<Changes>;

    /// Names and values of the state on the host that a resumed run needs.
    fn state(&self) -> Vec<(String, String)> {
        Vec::new()
    }

    /// Restores [`Strategy::state`].
    ///
    /// # Errors
    /// [`Error::Argument`] for a state that the strategy does not know.
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

/// Options of densification by gradients, which other strategies refuse.
pub(super) const NOT_IN_OTHERS: [&str; 7] =
    ["cap_ratio", "absgrad", "split", "importance", "growth_curve", "recovery", "late_min_opacity"];

/// Error for a checkpoint with work that the strategy does not have.
pub(super) fn unknown(strategy: &str, action: Actions) -> Error {
    let problem = format!("has work ({:#x}) that the strategy {strategy} does not know", action.0);
    Error::argument("checkpoint", problem)
}

/// Returns the strategy that the settings select.
pub(super) fn of_settings(context: &Context, settings: &TrainSettings) -> Result<Box<dyn Strategy>> {
    Ok(match settings.strategy {
        StrategyType::Reference => Box::new(Reference::of_settings(context, settings)?),
        StrategyType::Fixed => Box::new(Fixed),
        StrategyType::Mcmc => Box::new(Mcmc::new(context)?),
        StrategyType::Budget => Box::new(Budget::new(context, settings)?),
    })
}

/// Optimises the initial Gaussians, and neither adds nor removes any.
pub struct Fixed;

impl Strategy for Fixed {
    fn name(&self) -> &'static str {
        "fixed"
    }

    fn check(&self, settings: &TrainSettings, _: u32) -> Result<()> {
        settings.refuse(self.name(), &NOT_IN_OTHERS)
    }

    fn work(&self, _: &TrainSettings, _: u32) -> StepWork {
        StepWork { accumulates: false, optimizes: true, optimizes_opacity: true, actions: Actions::NONE }
    }

    fn between_steps(&mut self, _: &mut Population, _: Actions) -> Result<Changes> {
        Ok(Changes::default())
    }
}
