//! Initial points for data sets without points.

use super::{AutoSwitch, Settings};
use crate::progress::thousands;
use crate::session;
use ashsplat::train::StrategyType;
use ashsplat::{Error, Result};
use ashsplat_files::init::RANDOM_POINTS;
use ashsplat_files::photo_points::PHOTO_POINTS;
use ashsplat_files::{Dataset, HostMemory};
use std::sync::atomic::AtomicBool;

impl Settings {
    /// True if points are searched for in the photos when there are none. By default, reference does not, to match the
    /// reference implementation, and fixed does not, since it cannot grow from few points.
    fn looks_for_points(&self) -> bool {
        match self.data.photo_points {
            AutoSwitch::Auto => matches!(self.train.strategy, StrategyType::Budget | StrategyType::Mcmc),
            AutoSwitch::On => true,
            AutoSwitch::Off => false,
        }
    }

    /// Number of initial points for a data set without points, as far as it is known before photos are read.
    pub fn missing_points(&self) -> usize {
        if self.looks_for_points() { PHOTO_POINTS } else { RANDOM_POINTS }
    }

    /// Refuses a data set that lacks points and may not start from others.
    fn check_points(&self, dataset: &Dataset) -> Result<()> {
        let requested = self.data.random_points || self.data.photo_points == AutoSwitch::On;
        if !dataset.points.is_empty() || requested || dataset.may_lack_points() {
            return Ok(());
        }
        let remedy = "register the photos with COLMAP's mapper or point_triangulator, or use --photo-points (looks for \
                      points in the photos) or --random-points";
        Err(Error::input(&self.data.source_path, "the model has no points to start from", remedy))
    }

    /// Refuses a data set that lacks points, or searches for some within the memory budget that it was loaded with.
    pub fn settle_points(
        &self,
        dataset: &mut Dataset,
        memory: &HostMemory,
        quiet: bool,
        stop: &AtomicBool,
    ) -> Result<()> {
        self.check_points(dataset)?;
        if !dataset.points.is_empty() || !self.looks_for_points() {
            return Ok(());
        }
        let found = session::counted("looking for points in the photos", quiet, stop, |progress| {
            dataset.points_in_photos(u64::from(self.train.seed), memory, progress)
        })?;
        match found {
            Ok(points) => {
                if !quiet {
                    let count = thousands(points.len() as u64);
                    errln!("no points to start from; {count} at which the photos agree stand in for them");
                }
                dataset.set_points(points);
            }
            Err(count) => errln!("warning: the photos agree at {count} points only, too few to start from"),
        }
        Ok(())
    }
}
