//! Everything that is wrong with a data set, at once.

use std::collections::BTreeMap;
use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};

use rayon::prelude::*;

use super::{DatasetOptions, PlannedView, check_split, plan_views};
use crate::Result;
use crate::io::colmap::{self, Model};
use crate::io::progress::Progress;
use crate::scene::{Bounds, scene_extent};

/// What a data set contains and what is wrong with it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DatasetReport {
    /// The folder of the COLMAP model, when there is one.
    pub model: Option<PathBuf>,
    /// Number of cameras by "MODEL WIDTHxHEIGHT".
    pub cameras: BTreeMap<String, usize>,
    /// Number of registered images.
    pub images: usize,
    /// Number of photos that are present, whole and of their camera's size.
    pub sound_photos: usize,
    /// Number of views that training would use, with the given options.
    pub train_views: usize,
    /// Number of views that would be held out.
    pub test_views: usize,
    /// Number of points.
    pub points: usize,
    /// Box around the points, world units.
    pub point_bounds: Option<Bounds>,
    /// Box around the centres of the usable cameras, world units.
    pub camera_bounds: Option<Bounds>,
    /// Scene extent over the usable training cameras, world units.
    pub scene_extent: f32,
    /// Problems that prevent training, one line each.
    pub problems: Vec<String>,
    /// What the user should know though it does not prevent training.
    pub warnings: Vec<String>,
}

impl DatasetReport {
    /// Whether training can start.
    pub fn is_sound(&self) -> bool {
        self.problems.is_empty()
    }
}

pub(super) fn inspect(path: &Path, options: &DatasetOptions, progress: Progress<'_>) -> DatasetReport {
    let mut report = DatasetReport::default();
    let model = match colmap::find(path).and_then(|found| {
        report.model = Some(found.folder.clone());
        Model::read(&found)
    }) {
        Ok(model) => model,
        Err(e) => {
            report.problems.push(e.to_string());
            return report;
        }
    };
    report.describe(&model);
    let views: Vec<_> = plan_views(path, &model, options)
        .into_iter()
        .filter_map(|view| view.map_err(|e| report.problem(e.to_string())).ok())
        .collect();
    if report.problems.is_empty()
        && let Err(e) = check_split(&model, options, views.len())
    {
        report.problem(e.to_string());
    }
    report.split(&views, options);
    report.check_photos(&views, options, progress);
    report
}

impl DatasetReport {
    /// Notes a problem once: many images share a camera.
    fn problem(&mut self, problem: String) {
        if !self.problems.contains(&problem) {
            self.problems.push(problem);
        }
    }

    fn describe(&mut self, model: &Model) {
        for camera in model.cameras.values() {
            let kind = format!("{} {}x{}", camera.model.name(), camera.width, camera.height);
            *self.cameras.entry(kind).or_default() += 1;
        }
        self.images = model.images.len();
        self.points = model.points.len();
        self.point_bounds = model.points.bounds();
        self.warnings.clone_from(&model.warnings);
        if model.points.is_empty() {
            self.warnings.push("no points to start from; training needs --random-points".into());
        }
    }

    fn split(&mut self, views: &[PlannedView<'_>], options: &DatasetOptions) {
        self.test_views = (0..views.len()).filter(|&index| options.is_test(index)).count();
        self.train_views = views.len() - self.test_views;
        let position = |view: &PlannedView<'_>| view.camera.position();
        self.camera_bounds = Bounds::of(views.iter().map(position));
        let train = views.iter().enumerate().filter(|(index, _)| !options.is_test(*index));
        self.scene_extent = scene_extent(train.map(|(_, view)| position(view)));
    }

    fn check_photos(&mut self, views: &[PlannedView<'_>], options: &DatasetOptions, progress: Progress<'_>) {
        let done = AtomicUsize::new(0);
        let check = |view: &PlannedView<'_>| -> Result<()> {
            progress.check()?;
            let result = view.read_photo(options);
            progress.step(done.fetch_add(1, Ordering::Relaxed) + 1, views.len());
            result.map(drop)
        };
        let results: Vec<_> = views.par_iter().map(check).collect();
        self.sound_photos = results.iter().filter(|result| result.is_ok()).count();
        results.into_iter().filter_map(Result::err).for_each(|e| self.problem(e.to_string()));
    }
}

impl fmt::Display for DatasetReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(model) = &self.model {
            writeln!(f, "model     {}", model.display())?;
        }
        for (kind, count) in &self.cameras {
            writeln!(f, "cameras   {count} × {kind}")?;
        }
        writeln!(f, "images    {} registered, {} sound photos", self.images, self.sound_photos)?;
        writeln!(f, "views     {} for training, {} held out", self.train_views, self.test_views)?;
        writeln!(f, "points    {}", self.points)?;
        for (what, bounds) in [("points", self.point_bounds), ("cameras", self.camera_bounds)] {
            if let Some(Bounds { min, max }) = bounds {
                writeln!(f, "box       {what} from {min:.3} to {max:.3}")?;
            }
        }
        writeln!(f, "extent    {:.4}", self.scene_extent)?;
        for warning in &self.warnings {
            writeln!(f, "warning   {warning}")?;
        }
        for problem in &self.problems {
            writeln!(f, "problem   {problem}")?;
        }
        Ok(())
    }
}
