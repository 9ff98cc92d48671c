//! The photos of a data set one at a time, for those who look at a few.

use std::path::Path;

use super::plan::{Plan, PlannedView};
use super::{DatasetOptions, Unpacked, View};
use crate::io::cameras_json::NamedCamera;
use crate::scene::PointCloud;
use crate::{Error, Result};

/// The views of a data set, whose photos are read when they are asked for.
pub struct Gallery {
    unpacked: Unpacked,
    options: DatasetOptions,
    views: Vec<PlannedView>,
    held_out: Vec<bool>,
    points: PointCloud,
    warnings: Vec<String>,
}

impl Gallery {
    /// Finds out what a data set (or a ZIP of one) consists of; the photos are not decoded.
    ///
    /// # Errors
    /// As [`super::Dataset::load`], but for the photos' contents.
    pub fn open(path: impl AsRef<Path>, options: &DatasetOptions) -> Result<Self> {
        let unpacked = Unpacked::open(path.as_ref())?;
        let plan = Plan::of(unpacked.folder(), options).map_err(|error| unpacked.name(error))?;
        let held_out = (0..plan.views.len()).map(|index| plan.is_test(index, options)).collect();
        let Plan { views, points, list, warnings, .. } = plan;
        let views: Vec<PlannedView> =
            views.into_iter().collect::<Result<_>>().map_err(|error| unpacked.name(error))?;
        if views.is_empty() {
            let error = Error::input(list, "no images are registered", "run COLMAP's mapper again");
            return Err(unpacked.name(error));
        }
        Ok(Self { unpacked, options: options.clone(), views, held_out, points, warnings })
    }

    /// The cameras by name, at the photos' own sizes.
    pub fn cameras(&self) -> Vec<NamedCamera> {
        let named = |view: &PlannedView| NamedCamera { name: view.name.clone(), camera: view.camera() };
        self.views.iter().map(named).collect()
    }

    /// Whether each view, by name, is held out; none is without [`DatasetOptions::eval`].
    pub fn held_out(&self) -> &[bool] {
        &self.held_out
    }

    /// What the user should know though it does not prevent using the photos.
    pub fn warnings(&self) -> &[String] {
        &self.warnings
    }

    /// The points that the data set comes with; there may be none.
    pub fn points(&self) -> &PointCloud {
        &self.points
    }

    /// Reads a photo, undistorted and scaled as the options say; `None` beyond the last.
    ///
    /// # Errors
    /// As [`super::Dataset::load`].
    pub fn view(&self, index: usize) -> Option<Result<View>> {
        let view = self.views.get(index)?;
        Some(view.load(&self.options).map_err(|error| self.unpacked.name(error)))
    }
}
