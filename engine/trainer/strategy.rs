//! Adaptive density control as a part of training that can be exchanged.
//!
//! A strategy decides what an iteration accumulates, what happens to the set of Gaussians between two steps,
//! what it adds to the parameters and to the loss, and what of it belongs into memory and checkpoint.
//! [`Reference`](super::Reference) is that of Kerbl et al. 2023.

pub use super::work::{ABSOLUTE_STATISTIC, Actions, Changes, Densified, GRADIENT_STATISTIC, Statistic, Work};

use super::population::Population;
use super::settings::TrainSettings;
use crate::error::Result;
use crate::forward::FrameInputs;
use crate::loss::LossTerm;
use crate::optimizer::{Moments, Step};
use crate::vk::{Buffer, Context, Recorder};

/// What a strategy records into a step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Hooks {
    /// Whether [`Strategy::record_statistics`] is called.
    pub statistics: bool,
    /// Whether [`Strategy::record_update`] is called, after steps of the optimiser.
    pub update: bool,
    /// Whether [`Work::sums_gradients`] may be set. The sums take no memory of their own, but kernels.
    pub sums: bool,
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
/// Kernels are built when the strategy is made, or between two steps; recording neither allocates nor waits.
/// The planes of the Gaussians may lie in other buffers, with another [`ScenePlan`](crate::plan::ScenePlan), in each step.
pub trait Strategy: Send {
    /// Its name in messages.
    fn name(&self) -> &'static str;

    /// Checks that a training with these settings can begin with so many Gaussians.
    ///
    /// # Errors
    /// [`Error::Argument`](crate::Error::Argument) with what would be right.
    fn check(&self, _: &TrainSettings, _gaussians: u32) -> Result<()> {
        Ok(())
    }

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
    /// keeps them in the checkpoint. The backward pass accumulates [`ABSOLUTE_STATISTIC`] if it is among them.
    fn statistics(&self) -> Vec<Statistic> {
        Vec::new()
    }

    /// Which of `record_statistics` and `record_update` it uses. Unused ones are not called.
    fn records(&self) -> Hooks {
        Hooks::default()
    }

    /// Whether it chooses the Gaussians that it adds by [`GRADIENT_STATISTIC`] or [`ABSOLUTE_STATISTIC`]. In training of a
    /// [block](super::SceneBlock) those of Gaussians outside of its core are below every threshold when it densifies.
    fn grows_by_statistics(&self) -> bool {
        true
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
