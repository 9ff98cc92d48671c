//! The contents of a data set of any format before its photos are read.

use std::collections::{BTreeMap, HashSet};
use std::path::{Path, PathBuf};

use glam::{DVec3, Vec3};

use super::level::Level;
use super::notes;
use super::options::DatasetOptions;
use super::planned_view::PlannedView;
use super::unpacked::Unpacked;
use crate::names::first_with;
use ashsplat::scene::{Camera, PointCloud, SourcePoints, WorldFrame, far_camera, median_ball, strays};
use ashsplat::{Error, Result};

#[derive(Default)]
pub(super) struct Plan {
    /// The folder of the model, or the file with the cameras.
    pub(super) source: PathBuf,
    /// The file that lists the views.
    pub(super) list: PathBuf,
    /// The views by name, or the reason why one cannot be used.
    pub(super) views: Vec<Result<PlannedView>>,
    /// Number of images that have a camera.
    pub(super) registered: usize,
    /// True if the data set itself specifies the held-out views.
    pub(super) has_split: bool,
    /// The rotation of views and points to the source coordinates.
    pub(super) level: Level,
    /// The frame of views and points.
    pub(super) frame: WorldFrame,
    pub(super) points: PointCloud,
    /// Number of cameras by "MODEL WIDTHxHEIGHT".
    pub(super) cameras: BTreeMap<String, usize>,
    pub(super) warnings: Vec<String>,
    /// Harmless notes on the treatment of the photos.
    pub(super) notes: Vec<String>,
    /// Number of depth maps that a transforms.json names.
    pub(super) named_depth_maps: usize,
    /// Names the cameras that have a lens.
    pub(super) distorted: Option<String>,
}

impl Plan {
    /// Adds a warning about the file that lists the views.
    pub(super) fn warn(&mut self, problem: impl std::fmt::Display) {
        self.warnings.push(format!("{}: {problem}", self.list.display()));
    }

    /// Replaces temporary paths by paths in the archive.
    pub(super) fn name_paths(&mut self, unpacked: &Unpacked) {
        self.warnings.iter_mut().chain(&mut self.notes).for_each(|line| *line = unpacked.name_in(line));
        self.source = unpacked.named(&self.source);
    }

    /// Chooses the frame unless one is given, and moves views and points into it.
    pub(super) fn settle_frame(&mut self, given: Option<WorldFrame>, mut points: SourcePoints) {
        self.leave_out_copies(&mut points);
        self.lighten_black(&mut points);
        let views: Vec<&PlannedView> = self.views.iter().flatten().collect();
        self.frame = given.unwrap_or_else(|| frame_of(&views, &points));
        if is_far(&views, &points, &self.frame) {
            let origin = self.frame.origin;
            self.warn(format!(
                "the data set lies far from the origin of the scene or checkpoint that it is used with ({origin}), so that single \
                 precision rounds its cameras"
            ));
        }
        self.views.iter_mut().flatten().for_each(|view| view.frame = self.frame);
        self.points = points.in_frame(&self.frame);
    }

    /// Removes points at the position of another point if these are half or more, because Gaussians take their size
    /// from the distance to neighbours. COLMAP's own models have up to a tenth of such points.
    fn leave_out_copies(&mut self, points: &mut SourcePoints) {
        let mut seen = HashSet::new();
        let is_first: Vec<bool> =
            points.positions.iter().map(|point| seen.insert(point.to_array().map(f64::to_bits))).collect();
        let (count, copies) = (points.len(), points.len() - seen.len());
        if copies < 100 || 5 * copies < count {
            return;
        }
        let what = format!("{copies} of {count} points lie exactly where others do");
        if 2 * copies < count {
            return self.warn(format!("{what}: their Gaussians begin smaller"));
        }
        points.retain(&is_first);
        self.warn(format!("{what} and are left out"));
    }

    /// Makes points grey if all are black. Programs write black for points without colours, and black Gaussians hardly
    /// learn, because colours below 0 have no gradient.
    fn lighten_black(&mut self, points: &mut SourcePoints) {
        if !points.is_empty() && points.colors.iter().all(|color| *color == [0; 3]) {
            points.colors.fill([127; 3]);
            self.warnings.push(format!("{}: all its points are black and start grey", self.source.display()));
        }
    }

    /// Names files that other programs use and ashsplat does not.
    pub(super) fn tell_of_unused_files(&mut self, dataset: &Path, options: &DatasetOptions) {
        let there = |names: &[&str]| -> Vec<String> {
            let folders = [dataset, &self.source];
            let files = folders.iter().flat_map(|folder| names.iter().map(move |name| folder.join(name)));
            files.filter(|file| file.is_file()).map(|file| file.display().to_string()).collect()
        };
        if options.eval && !self.has_split {
            let lists = there(&["train_list.txt", "test_list.txt", "val_list.txt", "test.txt"]);
            if !lists.is_empty() {
                let (lists, every) = (lists.join(", "), options.test_every);
                self.warnings.push(format!("{lists}: not used; one in {every} views is held out"));
            }
        }
        if let Some(start) = there(&["init.ply"]).first().filter(|_| !self.points.is_empty()) {
            self.warnings
                .push(format!("{start}: not used, because there are other points; `--init` takes Gaussians"));
        }
    }

    /// Names point files that are not read, if the data set has no other points.
    pub(super) fn tell_of_points(&mut self, dataset: &Path) {
        const ENDINGS: [&str; 8] = ["las", "laz", "e57", "pts", "ptx", "xyz", "pcd", "ply"];
        // Beside a transforms.json, any PLY is used or named already.
        let endings = if self.source == self.list { &ENDINGS[..7] } else { &ENDINGS[..] };
        if let Some(file) = first_with(dataset, endings) {
            let target = match self.source == self.list {
                true => dataset.join("points3d.ply"),
                false => self.source.join("points3D.ply"),
            };
            let (file, target) = (file.display(), target.display());
            self.warnings.push(format!(
                "{file}: its points are not used; save them in the cameras' coordinates as {target} (CloudCompare and PDAL write PLY)"
            ));
        }
    }

    /// Names the cameras that the scene extent ignores, or the farthest one that decides it.
    pub(super) fn warn_of_strays(&mut self) {
        let views: Vec<&PlannedView> = self.views.iter().flatten().collect();
        let positions: Vec<Vec3> = views.iter().map(|view| view.camera().position()).collect();
        let strays = strays(&positions);
        let mut strays = views.iter().zip(strays).filter_map(|(view, stray)| Some((&view.name, stray?)));
        if let Some((name, times)) = strays.next() {
            let (name, others) = (name.clone(), strays.count());
            let others = if others > 0 { format!(" (and {others} others)") } else { String::new() };
            self.warn(format!(
                "the camera of {name}{others} lies at {times:.0} times the median distance from the cameras' middle, alone; \
                 the scene extent leaves it out: if its pose is wrong, remove it"
            ));
        } else if let Some((index, times)) = far_camera(&positions) {
            let name = views[index].name.clone();
            self.warn(format!(
                "the camera of {name} lies at {times:.0} times the median distance from the cameras' middle, with others, and decides the \
                 scene extent: if their poses are wrong, remove them"
            ));
        }
    }

    /// Warns of cameras that can hardly belong to their photos.
    pub(super) fn warn_of_lenses(&mut self) {
        let of_model = self.source != self.list;
        let mut known = HashSet::new();
        let views = self.views.iter().flatten().filter(|view| known.insert(format!("{:?}", view.lens)));
        let name = |view: &PlannedView| match of_model {
            true => format!("camera {}", view.camera_id),
            false => format!("frame {}", view.name),
        };
        let named = views.map(|view| (name(view), &view.lens));
        self.warnings.extend(notes::lens_warning(&self.list, named));
    }

    /// Warns of points that hardly any camera sees: they belong to another frame or another scene.
    pub(super) fn warn_of_points_out_of_view(&mut self) {
        const SAMPLE: usize = 500;
        const LEAST_SEEN: f32 = 0.1;
        let views = self.views.iter().flatten().step_by(self.views.len().div_ceil(SAMPLE).max(1));
        let cameras: Vec<Camera> = views.map(PlannedView::camera).collect();
        let sample = |count: usize| {
            let step = self.points.len().div_ceil(count).max(1);
            self.points.positions.iter().step_by(step).copied().map(Vec3::from_array)
        };
        let (all, source) = (sample(SAMPLE).count(), self.source.display());
        let seen = sample(SAMPLE).filter(|&p| cameras.iter().any(|camera| camera.sees(p))).count();
        if !cameras.is_empty() && (seen as f32) < LEAST_SEEN * all as f32 {
            self.warnings.push(format!(
                "{source}: {seen} of {all} of its points (a sample) lie in the view of a camera: are they of another frame or scene?"
            ));
            return;
        }
        // With poses from world to camera, many cameras look past the scene. In large scenes each camera sees few points, but some.
        const DENSE: usize = 20_000;
        const LEAST_CAMERAS: usize = 10;
        let blind = cameras.iter().filter(|camera| !sample(DENSE).any(|point| camera.sees(point))).count();
        if self.points.len() >= SAMPLE && cameras.len() >= LEAST_CAMERAS && 5 * blind >= cameras.len() {
            let all = cameras.len();
            self.warn(format!(
                "{blind} of {all} of its cameras (a sample) see none of the points: are the poses right, and from camera to world?"
            ));
        }
    }

    /// Settles which views are held out: those that the data set names, or else some by their number.
    pub(super) fn settle_split(&mut self, options: &DatasetOptions) {
        let by_number = options.held_out(self.views.len());
        for (view, by_number) in self.views.iter_mut().zip(by_number) {
            let Ok(view) = view else { continue };
            view.held_out = if self.has_split { options.eval && view.held_out } else { by_number };
        }
    }

    /// Refuses a data set without views.
    pub(super) fn check_views(&self) -> Result<()> {
        if !self.views.is_empty() {
            return Ok(());
        }
        let remedy = "run COLMAP's mapper again with more overlapping photos";
        Err(Error::input(&self.list, "no images are registered", remedy))
    }
}

/// Refuses a split that leaves no views to train on.
pub(super) fn check_split(list: &Path, views: &[PlannedView]) -> Result<()> {
    if views.iter().any(|view| !view.held_out) {
        return Ok(());
    }
    let problem = format!("all of its {} images are held out, none is left to train on", views.len());
    Err(Error::input(list, problem, "train without --eval"))
}

/// Most points and views that are sampled.
const SAMPLE: usize = 2000;
const VIEWS: usize = 200;
/// The near depth is the depth below which one in this many visible points lies.
const NEAR_SHARE: usize = 20;
/// Near depths, source units, at which the unit stays 1. Below, the near limit of 0.2 hides Gaussians: at 0.2 the demo
/// loses 3 dB. Above, inverse depths are too small for the losses that compare them.
const KEPT: std::ops::Range<f64> = 0.3..1000.0;
/// Distance from a frame's origin, in radii of the data set, at which single precision resolves a 16,000th of the
/// radius. Nearer data sets keep the origin of their files, so that a model's PLY has their coordinates.
const FAR: f64 = 1000.0;

/// The frame of a data set. Its origin is the default, or the middle of points and cameras if they are far from that.
/// Its unit brings the near depth to between 1 and 10.
///
/// Without visible points, the cameras' median distance from their middle replaces the near depth.
fn frame_of(views: &[&PlannedView], points: &SourcePoints) -> WorldFrame {
    let mut depths: Vec<f64> = Vec::new();
    for view in views.iter().step_by(views.len().div_ceil(VIEWS).max(1)) {
        depths.extend(sample(points).filter_map(|point| view.depth_of(point)));
    }
    let near = match depths.len() / NEAR_SHARE {
        0 => median_ball(&centers(views)).map_or(0.0, |(_, radius)| radius),
        rank => *depths.select_nth_unstable_by(rank, f64::total_cmp).1,
    };
    // Parsed, because the powers of some systems miss it.
    let decade: f64 = format!("1e{}", libm::log10(near).floor()).parse().unwrap_or(0.0);
    let keeps = KEPT.contains(&near) || !(decade > 0.0 && decade.is_finite());
    let usual = WorldFrame::default();
    let is_far = is_far(views, points, &usual);
    let around = if is_far { WorldFrame::around(&all(views, points)) } else { usual };
    WorldFrame { unit: if keeps { 1.0 } else { decade }, ..around }
}

/// True if single precision rounds a data set in a frame that was not chosen for it, such as the frame of another scene.
fn is_far(views: &[&PlannedView], points: &SourcePoints, frame: &WorldFrame) -> bool {
    median_ball(&all(views, points))
        .is_some_and(|(center, radius)| center.distance(frame.origin) > FAR * radius)
}

fn sample(points: &SourcePoints) -> impl Iterator<Item = DVec3> {
    points.positions.iter().copied().step_by(points.len().div_ceil(SAMPLE).max(1))
}

pub(super) fn centers(views: &[&PlannedView]) -> Vec<DVec3> {
    views.iter().map(|view| view.source_position()).collect()
}

/// A sample of the points, and all cameras.
fn all(views: &[&PlannedView], points: &SourcePoints) -> Vec<DVec3> {
    sample(points).chain(centers(views)).collect()
}
