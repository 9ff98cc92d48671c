//! Means of the parameters over the last steps of a run: [`TrainSettings::average_last`].
//!
//! They share the buffers of the gradient sums that steps of several views use, so the two exclude each other.

use super::Trainer;
use super::checkpoint::MeanState;
use super::settings::TrainSettings;
use super::strategy::Strategy;
use crate::error::{Error, Result};
use crate::forward::SceneBuffers;
use crate::planes;

/// Refuses averaging together with steps of several views.
pub(super) fn check(settings: &TrainSettings, strategy: &dyn Strategy) -> Result<()> {
    if settings.average_last > 0.0 && strategy.records().sums {
        let problem = format!(
            "is {} (presets and few photos set it), which needs a step after each view; give 0, or multi_step = false",
            settings.average_last
        );
        return Err(Error::argument("average_last", problem));
    }
    Ok(())
}

impl Trainer {
    /// Replaces the parameters by their means. Used if the frame that would record this does not fit.
    pub(super) fn end_means(&mut self) -> Result<()> {
        let model = &self.state.model;
        self.context.run("end means", |r| {
            for (mean, parameters) in model.spare.iter().zip(&model.scene.chunks) {
                r.copy(mean, parameters);
            }
            self.losses.light.record_end(r);
            Ok(())
        })?;
        self.compute_filters()?;
        self.state.progress.averaged = 0;
        Ok(())
    }

    /// Means for the checkpoint; None before the first averaged step.
    pub(super) fn mean_state(&self) -> Result<Option<MeanState>> {
        let model = &self.state.model;
        match self.state.progress.averaged {
            0 => Ok(None),
            steps => Ok(Some(MeanState {
                steps,
                gaussians: planes::download(
                    &self.context,
                    &SceneBuffers { chunks: model.spare.clone(), ..model.scene.clone() },
                )?,
                light: self.light_sums()?,
            })),
        }
    }
}
