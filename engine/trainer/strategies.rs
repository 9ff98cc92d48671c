//! The strategies of density control that the library has.

mod fixed;
mod mcmc;
mod reference;

pub use fixed::Fixed;
pub use mcmc::Mcmc;
pub use reference::Reference;

use super::settings::{StrategyType, TrainSettings};
use super::strategy::Strategy;
use crate::error::Result;
use crate::vk::Context;

/// The strategy that the settings name.
///
/// # Errors
/// When the device refuses a pipeline.
pub(super) fn of_settings(context: &Context, settings: &TrainSettings) -> Result<Box<dyn Strategy>> {
    Ok(match settings.strategy {
        StrategyType::Default => Box::new(Reference::new(context)?),
        StrategyType::Fixed => Box::new(Fixed),
        StrategyType::Mcmc => Box::new(Mcmc::new(context)?),
    })
}
