//! Reports all problems of a data set at once.

use std::collections::{BTreeMap, HashSet};
use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};

use rayon::prelude::*;

use super::notes::{self, may_lack_points, random_points_instead};
use super::plan::Plan;
use super::planned_view::{PhotoUse, PlannedView};
use super::unpacked::Unpacked;
use super::{DatasetOptions, reader};
use crate::colmap;
use crate::progress::Progress;
use ashsplat::scene::{Bounds, WorldFrame, scene_extent};
use ashsplat::{Error, Result};

/// Contents and problems of a data set.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DatasetReport {
    /// The folder of the COLMAP model, or the transforms.json, when there is one.
    pub model: Option<PathBuf>,
    /// Number of cameras by "MODEL WIDTHxHEIGHT".
    pub cameras: BTreeMap<String, usize>,
    /// Number of registered images.
    pub images: usize,
    /// Number of photos that exist, are complete and have their camera's size.
    pub sound_photos: usize,
    /// Number of views that training would use, with the given options.
    pub train_views: usize,
    /// Number of views that would be held out.
    pub test_views: usize,
    /// Number of points.
    pub points: usize,
    /// The frame of boxes and extent.
    pub frame: WorldFrame,
    /// Box around the points, world units.
    pub point_bounds: Option<Bounds>,
    /// Box around the centres of the usable cameras, world units.
    pub camera_bounds: Option<Bounds>,
    /// Scene extent over the usable training cameras, world units.
    pub scene_extent: f32,
    /// Problems that prevent training, one line each.
    pub problems: Vec<String>,
    /// Warnings that do not prevent training.
    pub warnings: Vec<String>,
    /// Harmless notes on the treatment of the photos.
    pub notes: Vec<String>,
    /// The problems as a set, for the search for duplicates.
    known: HashSet<String>,
}

impl DatasetReport {
    /// True if training can start.
    pub fn is_sound(&self) -> bool {
        self.problems.is_empty()
    }

    /// True if training refuses the data set without an explicit choice of initial points.
    pub fn needs_random_points(&self) -> bool {
        self.points == 0 && !self.model.as_deref().is_some_and(may_lack_points)
    }
}

pub(super) fn inspect(path: &Path, options: &DatasetOptions, progress: Progress<'_>) -> DatasetReport {
    let mut report = DatasetReport::default();
    let unpacked = match Unpacked::open(path, progress) {
        Ok(unpacked) => unpacked,
        Err(e) => {
            report.problem(e.to_string());
            return report;
        }
    };
    let named = |e: Error| unpacked.name(e).to_string();
    let mut plan = match reader::plan(&unpacked.folder, options) {
        Ok(plan) => plan,
        Err(e) => {
            report.model = colmap::find(&unpacked.folder).ok().map(|found| unpacked.named(&found.folder));
            report.problem(named(e));
            return report;
        }
    };
    plan.name_paths(&unpacked);
    report.describe(&mut plan);
    plan.take_problems().into_iter().for_each(|problem| report.problem(named(problem)));
    let split = plan.check_views().and_then(|()| plan.check_split());
    if report.problems.is_empty()
        && let Err(e) = split
    {
        report.problem(named(e));
    }
    report.split(&plan.views);
    report.check_photos(&plan.views, options, progress, &named);
    report
}

impl DatasetReport {
    /// Notes a problem once: many images share a camera.
    fn problem(&mut self, problem: String) {
        if self.known.insert(problem.clone()) {
            self.problems.push(problem);
        }
    }

    fn describe(&mut self, plan: &mut Plan) {
        self.model = Some(plan.source.clone());
        self.cameras = std::mem::take(&mut plan.cameras);
        self.images = plan.registered;
        (self.points, self.point_bounds) = (plan.points.len(), plan.points.bounds());
        self.frame = plan.frame;
        (self.warnings, self.notes) = (std::mem::take(&mut plan.warnings), std::mem::take(&mut plan.notes));
        if plan.points.is_empty() {
            self.warnings.push(match may_lack_points(&plan.source) {
                true => random_points_instead(),
                false => "no points to start from; training needs --photo-points or --random-points".into(),
            });
        }
    }

    fn split(&mut self, views: &[PlannedView]) {
        self.test_views = views.iter().filter(|view| view.held_out).count();
        self.train_views = views.len() - self.test_views;
        let position = |view: &PlannedView| view.camera().position();
        self.camera_bounds = Bounds::of(views.iter().map(position));
        self.scene_extent = scene_extent(views.iter().filter(|view| !view.held_out).map(position));
    }

    fn check_photos(
        &mut self,
        views: &[PlannedView],
        options: &DatasetOptions,
        progress: Progress<'_>,
        named: &dyn Fn(Error) -> String,
    ) {
        let done = AtomicUsize::new(0);
        let check = |view: &PlannedView| -> Result<PhotoUse> {
            progress.check()?;
            let result = view.load(options);
            progress.step(done.fetch_add(1, Ordering::Relaxed) + 1, views.len());
            result.map(|(_, photo_use)| photo_use)
        };
        let results: Vec<_> = views.par_iter().map(check).collect();
        self.sound_photos = results.iter().filter(|result| result.is_ok()).count();
        let mut uses = Vec::new();
        for (view, result) in views.iter().zip(results) {
            match result {
                Ok(photo) => uses.push((view, photo)),
                Err(e) => self.problem(named(e)),
            }
        }
        let (notes, warnings) = notes::of_pixels(uses.into_iter(), options.alpha);
        self.notes.extend(notes);
        self.warnings.extend(warnings);
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
        let digits = 3 + (-self.frame.unit.log10()).max(0.0) as usize;
        for (what, bounds) in [("of the points", self.point_bounds), ("of the cameras", self.camera_bounds)] {
            if let Some(Bounds { min, max }) = bounds {
                let [min, max] = [min, max].map(|corner| self.frame.source(corner));
                writeln!(f, "box       {what}: from {min:.digits$} to {max:.digits$}")?;
            }
        }
        let extent = self.frame.unit * f64::from(self.scene_extent);
        writeln!(f, "extent    {extent:.*}", digits + 1)?;
        if !self.frame.is_identity() {
            let WorldFrame { origin, unit } = self.frame;
            writeln!(f, "frame     origin {} {} {}, unit {unit}", origin.x, origin.y, origin.z)?;
        }
        let kinds = [("note   ", &self.notes), ("warning", &self.warnings), ("problem", &self.problems)];
        let mut lines = kinds.iter().flat_map(|(kind, lines)| lines.iter().map(move |line| (kind, line)));
        lines.try_for_each(|(kind, line)| writeln!(f, "{kind}   {line}"))
    }
}
