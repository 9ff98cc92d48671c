//! The contents of a data set of any format before its photos are read.

use std::collections::{BTreeMap, HashSet};
use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use glam::{DMat3, DQuat, DVec3, Vec3};

use crate::dataset::planned_view::PlannedView;
use crate::dataset::unpacked::Unpacked;
use crate::dataset::{DatasetOptions, notes};
use crate::names::first_with;
use crate::text;
use ashsplat::scene::{
    Camera, PhotoLens, PointCloud, SourcePoints, WorldFrame, far_camera, level_up, median_ball, strays,
};
use ashsplat::{Error, Result};

#[derive(Default)]
pub(super) struct Plan {
    /// The folder of the model, or the file with the cameras.
    pub(super) source: PathBuf,
    /// The file that lists the views.
    pub(super) list: PathBuf,
    /// The usable views, by name.
    pub(super) views: Vec<PlannedView>,
    /// Why others cannot be used, each with its [`PlannedView::rank`].
    pub(super) problems: Vec<(usize, Error)>,
    /// Number of images that have a camera.
    pub(super) registered: usize,
    /// True if the data set itself specifies the held-out views.
    pub(super) has_split: bool,
    /// The rotation of views and points to the source coordinates.
    pub(super) level: Level,
    pub(super) frame: WorldFrame,
    pub(super) points: PointCloud,
    /// Number of cameras by "MODEL WIDTHxHEIGHT".
    pub(super) cameras: BTreeMap<String, usize>,
    pub(super) warnings: Vec<String>,
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

    /// Adds a view, or the reason why it cannot be used.
    pub(super) fn add(&mut self, view: Result<PlannedView>) {
        let rank = self.views.len() + self.problems.len();
        match view {
            Ok(view) => self.views.push(PlannedView { rank, ..view }),
            Err(e) => self.problems.push((rank, e)),
        }
    }

    /// Removes the views that a step refuses, and keeps the reasons.
    pub(super) fn refuse(&mut self, mut step: impl FnMut(&mut PlannedView) -> Result<()>) {
        let problems = &mut self.problems;
        self.views.retain_mut(|view| step(view).map_err(|e| problems.push((view.rank, e))).is_ok());
    }

    /// The problems so far, in the views' order.
    pub(super) fn take_problems(&mut self) -> Vec<Error> {
        self.problems.sort_by_key(|(rank, _)| *rank);
        self.problems.drain(..).map(|(_, e)| e).collect()
    }

    /// Chooses the frame unless one is given, and moves views and points into it.
    pub(super) fn settle_frame(&mut self, given: Option<WorldFrame>, mut points: SourcePoints) {
        self.leave_out_copies(&mut points);
        self.lighten_black(&mut points);
        self.frame = given.unwrap_or_else(|| frame_of(&self.views, &points));
        if is_far(&self.views, &points, &self.frame) {
            let origin = self.frame.origin;
            self.warn(format!(
                "the data set lies far from the origin of the scene or checkpoint that it is used with ({origin}), so that single \
                 precision rounds its cameras"
            ));
        }
        self.views.iter_mut().for_each(|view| view.frame = self.frame);
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
    pub(super) fn warn_of_unused_files(&mut self, dataset: &Path, options: &DatasetOptions) {
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
    pub(super) fn warn_of_unread_points(&mut self, dataset: &Path) {
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
        let positions: Vec<Vec3> = self.views.iter().map(|view| view.camera().position()).collect();
        let strays = strays(&positions);
        let mut strays = self.views.iter().zip(strays).filter_map(|(view, stray)| Some((&view.name, stray?)));
        if let Some((name, times)) = strays.next() {
            let (name, others) = (name.clone(), strays.count());
            let others = if others > 0 { format!(" (and {others} others)") } else { String::new() };
            self.warn(format!(
                "the camera of {name}{others} lies at {times:.0} times the median distance from the cameras' middle, alone; \
                 the scene extent leaves it out: if its pose is wrong, remove it"
            ));
        } else if let Some((index, times)) = far_camera(&positions) {
            let name = self.views[index].name.clone();
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
        let views = self.views.iter().filter(|view| known.insert(format!("{:?}", view.lens)));
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
        const MIN_SEEN: f32 = 0.1;
        let views = self.views.iter().step_by(self.views.len().div_ceil(SAMPLE).max(1));
        let cameras: Vec<Camera> = views.map(PlannedView::camera).collect();
        let sample = |count: usize| {
            let step = self.points.len().div_ceil(count).max(1);
            self.points.positions.iter().step_by(step).copied().map(Vec3::from_array)
        };
        let (all, source) = (sample(SAMPLE).count(), self.source.display());
        let seen = sample(SAMPLE).filter(|&p| cameras.iter().any(|camera| camera.sees(p))).count();
        if !cameras.is_empty() && (seen as f32) < MIN_SEEN * all as f32 {
            self.warnings.push(format!(
                "{source}: {seen} of {all} of its points (a sample) lie in the view of a camera: are they of another frame or scene?"
            ));
            return;
        }
        // With poses from world to camera, many cameras look past the scene. In large scenes each camera sees few points, but some.
        const DENSE: usize = 20_000;
        const MIN_CAMERAS: usize = 10;
        let blind = cameras.iter().filter(|camera| !sample(DENSE).any(|point| camera.sees(point))).count();
        if self.points.len() >= SAMPLE && cameras.len() >= MIN_CAMERAS && 5 * blind >= cameras.len() {
            let all = cameras.len();
            self.warn(format!(
                "{blind} of {all} of its cameras (a sample) see none of the points: are the poses right, and from camera to world?"
            ));
        }
    }

    /// Settles which views are held out: those that the data set names, or else some by their number.
    pub(super) fn settle_split(&mut self, options: &DatasetOptions) {
        let by_number = options.held_out(self.views.len() + self.problems.len());
        for view in &mut self.views {
            view.held_out = if self.has_split { options.eval && view.held_out } else { by_number[view.rank] };
        }
    }

    pub(super) fn check_views(&self) -> Result<()> {
        if !self.views.is_empty() {
            return Ok(());
        }
        let remedy = "run COLMAP's mapper again with more overlapping photos";
        Err(Error::input(&self.list, "no images are registered", remedy))
    }

    /// Refuses a split that leaves no views to train on.
    pub(super) fn check_split(&self) -> Result<()> {
        if self.views.iter().any(|view| !view.held_out) {
            return Ok(());
        }
        let count = self.views.len();
        let problem = format!("all of its {count} images are held out, none is left to train on");
        Err(Error::input(&self.list, problem, "train without --eval"))
    }
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
fn frame_of(views: &[PlannedView], points: &SourcePoints) -> WorldFrame {
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
fn is_far(views: &[PlannedView], points: &SourcePoints, frame: &WorldFrame) -> bool {
    median_ball(&all(views, points))
        .is_some_and(|(center, radius)| center.distance(frame.origin) > FAR * radius)
}

fn sample(points: &SourcePoints) -> impl Iterator<Item = DVec3> {
    points.positions.iter().copied().step_by(points.len().div_ceil(SAMPLE).max(1))
}

pub(super) fn centers(views: &[PlannedView]) -> Vec<DVec3> {
    views.iter().map(|view| view.source_position()).collect()
}

/// A sample of the points, and all cameras.
fn all(views: &[PlannedView], points: &SourcePoints) -> Vec<DVec3> {
    sample(points).chain(centers(views)).collect()
}

/// Finds the lenses of the pictures that are used. Views share a few lenses, and undistorting is expensive to prepare.
pub(super) struct UsedLenses<'a> {
    options: &'a DatasetOptions,
    /// A lens and the used one, by the lens's debug text, which differs whenever a number does.
    pub(super) known: BTreeMap<String, (PhotoLens, Option<PhotoLens>)>,
}

impl<'a> UsedLenses<'a> {
    pub(super) fn new(options: &'a DatasetOptions) -> Self {
        Self { options, known: BTreeMap::new() }
    }

    /// See [`DatasetOptions::used_lens`].
    pub(super) fn of(&mut self, lens: PhotoLens) -> Option<PhotoLens> {
        let used = || (lens, self.options.used_lens(&lens));
        self.known.entry(format!("{lens:?}")).or_insert_with(used).1
    }
}

/// Direction that viewers show above: -y, as in pictures.
const UP: DVec3 = DVec3::NEG_Y;

/// Rotation that turns a data set upright, so that its up direction becomes -y. All that is read, trained and written is in the
/// turned coordinates.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Level {
    /// The files' coordinates.
    #[default]
    Off,
    /// Up is the direction across the cameras' horizontal axes.
    On,
    /// The turn of an earlier reading.
    Turn {
        /// Up direction in the files' coordinates, of unit length.
        up: DVec3,
        /// Point that stays in its place, the files' coordinates.
        pivot: DVec3,
    },
}

impl Level {
    fn rotation(self) -> DMat3 {
        match self {
            Self::Turn { up, .. } => DMat3::from_quat(DQuat::from_rotation_arc(up, UP)),
            Self::Off | Self::On => DMat3::IDENTITY,
        }
    }

    /// Turned coordinates of a point in the files' coordinates.
    pub(super) fn turned(self, point: DVec3) -> DVec3 {
        match self {
            Self::Turn { pivot, .. } => pivot + self.rotation() * (point - pivot),
            Self::Off | Self::On => point,
        }
    }
}

impl FromStr for Level {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        let wrong =
            || Error::argument("level", format!("'{text}' is not off, on, or up direction and pivot"));
        match text {
            "off" => return Ok(Self::Off),
            "on" => return Ok(Self::On),
            _ => {}
        }
        let [a, b, c, x, y, z] = text::numbers(text).ok_or_else(wrong)?;
        let (up, pivot) = (DVec3::new(a, b, c), DVec3::new(x, y, z));
        let up = up.try_normalize().filter(|_| pivot.is_finite()).ok_or_else(wrong)?;
        Ok(Self::Turn { up, pivot })
    }
}

impl fmt::Display for Level {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Off => f.write_str("off"),
            Self::On => f.write_str("on"),
            Self::Turn { up, pivot } => {
                write!(f, "{},{},{},{},{},{}", up.x, up.y, up.z, pivot.x, pivot.y, pivot.z)
            }
        }
    }
}

impl Plan {
    /// Turns views and points, and notes the angle. [`Level::On`] turns them about the middle of the cameras.
    pub(super) fn turn_upright(&mut self, level: Level, points: &mut SourcePoints) {
        let by_cameras = || {
            let cameras: Vec<Camera> = self.views.iter().map(PlannedView::camera).collect();
            let (pivot, _) = median_ball(&centers(&self.views))?;
            Some(Level::Turn { up: level_up(&cameras)?.normalize(), pivot })
        };
        self.level = match level {
            Level::On => by_cameras().unwrap_or_default(),
            level => level,
        };
        let Level::Turn { up, pivot } = self.level else {
            if level == Level::On && !self.views.is_empty() {
                self.warn("its cameras have no common up direction, so that --level does not turn it");
            }
            return;
        };
        let (level, back) = (self.level, self.level.rotation().transpose());
        for view in &mut self.views {
            view.translation += view.camera_from_source * (pivot - back * pivot);
            view.camera_from_source *= back;
        }
        points.positions.iter_mut().for_each(|point| *point = level.turned(*point));
        let (list, angle) = (self.list.display(), up.angle_between(UP).to_degrees());
        self.notes
            .push(format!("{list}: the scene is turned by {angle:.1} degrees, so that up is -y (--level)"));
    }
}
