//! No density control.

use crate::error::Result;
use crate::trainer::population::Population;
use crate::trainer::settings::TrainSettings;
use crate::trainer::strategy::Strategy;
use crate::trainer::work::{Actions, Changes, Work};

/// Optimises the initial Gaussians, and neither adds nor removes any.
pub struct Fixed;

impl Strategy for Fixed {
    fn name(&self) -> &'static str {
        "fixed"
    }

    fn check(&self, settings: &TrainSettings, _: u32) -> Result<()> {
        settings.refuse(self.name(), &super::NOT_IN_OTHERS)
    }

    fn work(&self, _: &TrainSettings, _: u32) -> Work {
        Work {
            accumulates: false,
            optimizes: true,
            sums_gradients: false,
            optimizes_opacity: true,
            actions: Actions::NONE,
        }
    }

    fn between_steps(&mut self, _: &mut Population, _: Actions) -> Result<Changes> {
        Ok(Changes::default())
    }
}
