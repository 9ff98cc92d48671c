//! Loss terms that the settings can add to the photometric one.

mod inverse_depth;
mod regularizers;
mod sparse_depth;

pub use inverse_depth::InverseDepth;
pub use regularizers::Regularizers;
pub use sparse_depth::SparseDepth;

use super::settings::TrainSettings;
use crate::error::Result;
use crate::loss::LossTerm;
use crate::vk::Context;

/// Returns the terms with a weight above 0.
///
/// # Errors
/// When the device refuses a pipeline.
pub(super) fn of_settings(context: &Context, settings: &TrainSettings) -> Result<Vec<Box<dyn LossTerm>>> {
    let mut terms: Vec<Box<dyn LossTerm>> = Vec::new();
    let (opacity, scale) = (settings.opacity_reg, settings.scale_reg);
    if opacity > 0.0 || scale > 0.0 {
        terms.push(Box::new(Regularizers::new(context, opacity, scale)?));
    }
    Ok(terms)
}
