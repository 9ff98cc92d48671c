//! What training starts from where a data set has no points.

use crate::config::Settings;
use crate::progress::thousands;
use crate::session;
use ashsplat::trainer::{StrategyType, TrainSettings};
use ashsplat::{Error, Result};
use ashsplat_files::Dataset;
use ashsplat_files::init::RANDOM_POINTS;
use ashsplat_files::photo_points::PHOTO_POINTS;
use clap::Args;
use std::sync::atomic::AtomicBool;

/// The options that say so.
#[derive(Args)]
pub struct MissingPoints {
    /// Start from 100,000 random points where the data set has none, instead of refusing it; with --photo-points only
    /// if the photos show too few
    #[arg(long)]
    random_points: bool,
    /// Where the data set has no points, look for up to 20,000 at which the photos agree [default: true with --strategy
    /// budget and mcmc, false with reference]
    #[arg(long, value_name = "BOOL", num_args = 0..=1, require_equals = true, default_missing_value = "true")]
    photo_points: Option<bool>,
}

impl MissingPoints {
    fn looks(&self, settings: &TrainSettings) -> bool {
        self.photo_points.unwrap_or(looks_for_points(settings))
    }

    /// How many stand in, as far as is known before the photos are read.
    pub fn count(&self, settings: &TrainSettings) -> usize {
        if self.looks(settings) { PHOTO_POINTS } else { RANDOM_POINTS }
    }

    /// Refuses a data set that lacks points, or looks for some.
    pub fn settle(
        &self,
        dataset: &mut Dataset,
        settings: &Settings,
        quiet: bool,
        stop: &AtomicBool,
    ) -> Result<()> {
        if !dataset.points.is_empty() {
            return Ok(());
        }
        if !self.random_points && self.photo_points != Some(true) && !dataset.may_lack_points() {
            let remedy = "register the photos with COLMAP's mapper or point_triangulator, or use --photo-points \
                          (looks for points in the photos) or --random-points";
            let source = &settings.data.source_path;
            return Err(Error::input(source, "the model has no points to start from", remedy));
        }
        let train = &settings.train;
        if !self.looks(train) {
            return Ok(());
        }
        match session::points_in_photos(dataset, u64::from(train.seed), quiet, stop)? {
            Ok(points) => {
                if !quiet {
                    let count = thousands(points.len() as u64);
                    tell!("no points to start from; {count} at which the photos agree stand in for them");
                }
                dataset.set_points(points);
            }
            Err(count) => tell!("warning: the photos agree at {count} points only, too few to start from"),
        }
        Ok(())
    }
}

/// Whether a training looks for points in the photos where there are none, if nothing else is said: the strategy reference is what
/// it is, and fixed has no way to go on from few.
fn looks_for_points(settings: &TrainSettings) -> bool {
    matches!(settings.strategy, StrategyType::Budget | StrategyType::Mcmc)
}
