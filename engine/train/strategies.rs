//! Strategies of density control in this library.

mod budget;
mod mcmc;
mod rebuild;
mod reference;

pub use budget::{Budget, GrowthSchedule, QuantilePlace};
pub use mcmc::Mcmc;
pub use reference::Reference;

use super::population::Population;
use super::settings::{StrategyType, TrainSettings};
use super::strategy::{NOT_IN_OTHERS, Strategy};
use super::work::{Actions, Changes, Work};
use crate::error::Result;
use crate::vk::Context;

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

    fn work(&self, _: &TrainSettings, _: u32) -> Work {
        Work { accumulates: false, optimizes: true, optimizes_opacity: true, actions: Actions::NONE }
    }

    fn between_steps(&mut self, _: &mut Population, _: Actions) -> Result<Changes> {
        Ok(Changes::default())
    }
}
