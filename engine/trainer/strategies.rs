//! Strategies of density control in this library.

mod budget;
mod fixed;
mod mcmc;
mod rebuild;
mod reference;

pub use budget::{Budget, GrowthSchedule, QuantilePlace};
pub use fixed::Fixed;
pub use mcmc::Mcmc;
pub use reference::Reference;

use super::settings::{StrategyType, TrainSettings};
use super::strategy::Strategy;
use super::work::Actions;
use crate::error::{Error, Result};
use crate::vk::Context;

/// Options of densification by gradients, which other strategies refuse.
const NOT_IN_OTHERS: [&str; 8] = [
    "cap_ratio",
    "absgrad",
    "split",
    "importance",
    "growth_curve",
    "recovery",
    "multi_step",
    "late_min_opacity",
];

/// Returns the strategy that the settings select.
///
/// # Errors
/// When the device refuses a pipeline.
pub(super) fn of_settings(context: &Context, settings: &TrainSettings) -> Result<Box<dyn Strategy>> {
    Ok(match settings.strategy {
        StrategyType::Reference => Box::new(Reference::of_settings(context, settings)?),
        StrategyType::Fixed => Box::new(Fixed),
        StrategyType::Mcmc => Box::new(Mcmc::new(context)?),
        StrategyType::Budget => Box::new(Budget::new(context, settings)?),
    })
}

/// Error for a checkpoint with work that the strategy does not have.
fn unknown(strategy: &str, action: Actions) -> Error {
    let problem = format!("has work ({:#x}) that the strategy {strategy} does not know", action.0);
    Error::argument("checkpoint", problem)
}

/// Current name of a strategy in a checkpoint: older versions called the reference's `default`.
pub(super) fn present_name(name: &str) -> &str {
    if name == "default" { "reference" } else { name }
}
