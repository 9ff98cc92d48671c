//! The contents of a data set of any format before its photos are read.

use std::collections::{BTreeMap, HashSet};
use std::path::{Path, PathBuf};

use glam::{DVec3, Vec3};

use super::exif_orientation::Turned;
use super::mask::mask_in_folder;
use super::own_frame::{frame_of, is_far};
use super::planned_view::PlannedView;
use super::{DatasetOptions, doubtful_lens, lens_note, photo_folder, photo_sizes, scaling};
use crate::colmap::{self, ColmapImage, Model};
use crate::images::header;
use crate::names::{Finder, ending, photos_below, plain, stays_inside};
use crate::transforms::{self, Frame, Transforms};
use ashsplat::scene::lens::Lens;
use ashsplat::scene::{Camera, Intrinsics, PointCloud, SourcePoints, WorldFrame, far_camera, strays};
use ashsplat::{Error, Result};

/// Lenses and their pinhole replacements by the lens's debug text, which differs whenever a number does.
type Lenses = BTreeMap<String, (Lens, Option<Intrinsics>)>;

/// The problem of a lens that no pinhole can replace.
const NO_PINHOLE: &str =
    "sees too much for a pinhole, or its distortion folds the photo over, so that one place appears twice";
const NO_PINHOLE_REMEDY: &str =
    "crop the photos, or compute the camera again with fewer coefficients of distortion";

/// Views, points, and warnings.
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
    /// Names the cameras that have lens distortion.
    distorted: Option<String>,
}

impl Plan {
    /// Reads the contents of a data set. It finds the photos without decoding them, and opens those whose size is not
    /// known otherwise.
    pub(super) fn of(path: &Path, options: &DatasetOptions) -> Result<Self> {
        let files = transforms::find(path);
        let unused = transforms::unused(path, if colmap::exists(path) { None } else { files.as_deref() });
        let (mut plan, points) = match files {
            Some(files) if !colmap::exists(path) => {
                let mut transforms = Transforms::read(&files)?;
                let points = std::mem::take(&mut transforms.points);
                (Self::of_transforms(path, transforms, options)?, points)
            }
            _ => {
                let mut model = Model::of_dataset(path)?;
                let points = std::mem::take(&mut model.points);
                model.warnings.extend(colmap::contradiction(&model));
                (Self::of_model(path, &model, options)?, points)
            }
        };
        plan.warnings.extend(photo_sizes::fit(&mut plan.views, &plan.list, options.divisor()));
        plan.warnings.extend(unused);
        plan.find_companions(path, options);
        if points.is_empty() {
            plan.tell_of_points(path);
        }
        plan.settle_frame(options.frame, points);
        plan.tell_of_unused_files(path, options);
        plan.warn_of_strays();
        plan.warn_of_lenses();
        plan.warn_of_points_out_of_view();
        let size = |view: &PlannedView| (view.pinhole.width, view.pinhole.height);
        let sizes: Vec<(u32, u32)> = plan.views.iter().flatten().map(size).collect();
        plan.warnings.extend(scaling::warning(&sizes, options.resolution));
        let distorted = plan.views.iter().flatten().filter(|view| view.lens.is_distorted());
        let distorted: Vec<_> = distorted.map(size).collect();
        let note = lens_note::line(plan.distorted.as_deref(), &distorted, options.resolution);
        plan.notes.extend(note.or_else(|| scaling::note(&sizes, options.resolution)));
        Ok(plan)
    }

    /// Chooses the frame unless one is given, and moves views and points into it.
    fn settle_frame(&mut self, given: Option<WorldFrame>, mut points: SourcePoints) {
        self.leave_out_copies(&mut points);
        self.lighten_black(&mut points);
        let views: Vec<&PlannedView> = self.views.iter().flatten().collect();
        self.frame = given.unwrap_or_else(|| frame_of(&views, &points));
        if is_far(&views, &points, &self.frame) {
            self.warnings.push(format!(
                "{}: the data set lies far from the origin of the scene or checkpoint that it is used with ({}), so that single \
                 precision rounds its cameras",
                self.list.display(),
                self.frame.origin
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
        let (list, what) = (self.list.display(), "points lie exactly where others do");
        if 2 * copies < count {
            self.warnings.push(format!("{list}: {copies} of {count} {what}: their Gaussians begin smaller"));
            return;
        }
        points.retain(&is_first);
        self.warnings.push(format!("{list}: {copies} of {count} {what} and are left out"));
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
    fn tell_of_unused_files(&mut self, dataset: &Path, options: &DatasetOptions) {
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

    /// Names the cameras that the scene extent ignores, or the farthest one that decides it.
    fn warn_of_strays(&mut self) {
        let views: Vec<&PlannedView> = self.views.iter().flatten().collect();
        let positions: Vec<Vec3> = views.iter().map(|view| view.camera().position()).collect();
        let strays = strays(&positions);
        let mut strays = views.iter().zip(strays).filter_map(|(view, stray)| Some((&view.name, stray?)));
        if let Some((name, times)) = strays.next() {
            let (list, others) = (self.list.display(), strays.count());
            let others = if others > 0 { format!(" (and {others} others)") } else { String::new() };
            self.warnings.push(format!(
                "{list}: the camera of {name}{others} lies at {times:.0} times the median distance from the cameras' middle, alone; \
                 the scene extent leaves it out: if its pose is wrong, remove it"
            ));
        } else if let Some((index, times)) = far_camera(&positions) {
            self.warnings.push(format!(
                "{}: the camera of {} lies at {times:.0} times the median distance from the cameras' middle, with others, and decides the \
                 scene extent: if their poses are wrong, remove them",
                self.list.display(),
                views[index].name
            ));
        }
    }

    /// Warns of cameras that can hardly belong to their photos.
    fn warn_of_lenses(&mut self) {
        let of_model = self.source != self.list;
        let mut known = HashSet::new();
        let views = self.views.iter().flatten().filter(|view| known.insert(format!("{:?}", view.lens)));
        let named = views.map(|view| match of_model {
            true => (format!("camera {}", view.camera_id), &view.lens),
            false => (format!("frame {}", view.name), &view.lens),
        });
        self.warnings.extend(doubtful_lens::warning(&self.list, named));
    }

    /// Warns of points that hardly any camera sees: they belong to another frame or another scene.
    fn warn_of_points_out_of_view(&mut self) {
        const SAMPLE: usize = 500;
        const LEAST_SEEN: f32 = 0.1;
        let views = self.views.iter().flatten();
        let cameras: Vec<Camera> =
            views.step_by(self.views.len().div_ceil(SAMPLE).max(1)).map(PlannedView::camera).collect();
        let step = self.points.len().div_ceil(SAMPLE).max(1);
        let sample: Vec<Vec3> =
            self.points.positions.iter().step_by(step).copied().map(Vec3::from_array).collect();
        let seen = sample.iter().filter(|&&p| cameras.iter().any(|camera| camera.sees(p))).count();
        if !cameras.is_empty() && (seen as f32) < LEAST_SEEN * sample.len() as f32 {
            self.warnings.push(format!(
                "{}: {seen} of {} of its points (a sample) lie in the view of a camera: are they of another frame or scene?",
                self.source.display(),
                sample.len()
            ));
            return;
        }
        // With poses from world to camera, many cameras look past the scene. In large scenes each camera sees few points, but some.
        const DENSE: usize = 20_000;
        const LEAST_CAMERAS: usize = 10;
        let step = self.points.len().div_ceil(DENSE).max(1);
        let dense = || self.points.positions.iter().step_by(step).copied().map(Vec3::from_array);
        let blind = cameras.iter().filter(|camera| !dense().any(|point| camera.sees(point))).count();
        if self.points.len() >= SAMPLE && cameras.len() >= LEAST_CAMERAS && 5 * blind >= cameras.len() {
            self.warnings.push(format!(
                "{}: {blind} of {} of its cameras (a sample) see none of the points: are the poses right, and from camera to world?",
                self.list.display(),
                cameras.len()
            ));
        }
    }

    fn of_model(path: &Path, model: &Model, options: &DatasetOptions) -> Result<Self> {
        let mut plan = Self {
            source: model.source.folder.clone(),
            list: model.file("images"),
            views: Vec::new(),
            registered: model.images.len(),
            has_split: false,
            frame: WorldFrame::default(),
            points: PointCloud::default(),
            cameras: BTreeMap::new(),
            warnings: model.warnings.clone(),
            notes: Vec::new(),
            named_depth_maps: 0,
            distorted: None,
        };
        let mut images: Vec<&ColmapImage> = model.images.iter().collect();
        images.sort_by(|a, b| a.name.cmp(&b.name));
        let mut lenses = BTreeMap::new();
        for camera in model.cameras.values() {
            let kind = format!("{} {}x{}", camera.model.name(), camera.width, camera.height);
            *plan.cameras.entry(kind).or_default() += 1;
            // A problem of a camera is reported for the images that use it.
            if let Ok(lens) = model.lens(camera) {
                lenses.insert(camera.id, (lens, lens.inscribed_pinhole()));
            }
        }
        let known = lenses.values().map(|(lens, pinhole)| (lens, *pinhole));
        plan.distorted = lens_note::of(&model.file("cameras"), known);
        let folder = match photo_folder::find(path, &options.images) {
            Ok(folder) => folder,
            Err(e) => {
                plan.views.push(Err(e));
                return Ok(plan);
            }
        };
        let mut finder = Finder::default();
        let paths = plan.photo_paths(&images, &folder, &mut finder);
        let asked = images.iter().zip(&paths).map(|(image, path)| {
            let camera = model.cameras.get(&image.camera_id);
            (path.as_deref().ok(), camera.map(|camera| [camera.width as f64, camera.height as f64]))
        });
        // COLMAP itself never rotates photos, so no warning is needed if no size shows otherwise.
        let Turned { photos: turned, sizes, .. } =
            Turned::of(&asked.collect::<Vec<_>>(), options.orientation);
        let view =
            |image: &ColmapImage, photo_path: Result<PathBuf>, turned: bool, size: Option<(u32, u32)>| {
                model.camera_of(image)?;
                let Some(&(lens, Some(pinhole))) = lenses.get(&image.camera_id) else {
                    let problem = format!("camera {}: {NO_PINHOLE}", image.camera_id);
                    return Err(Error::input(model.file("cameras"), problem, NO_PINHOLE_REMEDY));
                };
                let photo_path = photo_path?;
                if !photo_path.is_file() {
                    let problem = format!("the photo of image {} is missing", image.id);
                    let remedy = "copy it there, or remove the image from the model";
                    return Err(Error::input(photo_path, problem, remedy));
                }
                // The name is shown and written. A path outside the photos' folder, such as another machine's, is
                // replaced.
                let name = match stays_inside(&plain(&image.name)) {
                    true => image.name.clone(),
                    false => {
                        photo_path.strip_prefix(&folder).unwrap_or(&photo_path).to_string_lossy().into_owned()
                    }
                };
                Ok(PlannedView {
                    name,
                    image_id: image.id,
                    camera_id: image.camera_id,
                    camera_from_source: image.rotation(),
                    translation: DVec3::from_array(image.translation),
                    alpha_is_mask: true,
                    ..PlannedView::of((lens, pinhole), photo_path, (turned, size))
                })
            };
        let names = images.iter().map(|image| image.name.as_str());
        plan.tell_of_photos_without_camera(photo_folder::found(path, &folder, names), path, &folder);
        plan.views = images
            .into_iter()
            .zip(paths)
            .zip(turned.into_iter().zip(sizes))
            .map(|((image, path), (turned, size))| view(image, path, turned, size))
            .collect();
        Ok(plan)
    }

    fn tell_of_photos_without_camera(&mut self, photos: Vec<PathBuf>, dataset: &Path, folder: &Path) {
        let registered = self.registered;
        let stems: HashSet<PathBuf> = photos.iter().map(|photo| photo.with_extension("")).collect();
        let (alike, photos) = (photos.len() - stems.len(), stems.len());
        if alike > 0 && photos + alike > registered {
            self.warnings.push(format!(
                "{}: {alike} of its photos have the name of another one but for the ending: those that {} names are used",
                folder.display(),
                self.list.display()
            ));
        }
        if photos > registered {
            self.warnings.push(format!(
                "{}: only {registered} of its {photos} photos have a camera: the others are not used ({})",
                folder.display(),
                photo_folder::advice_for_more(dataset)
            ));
        }
    }

    /// Finds the photos of a model's images: by their names, else by the ends of the names among photos that no other
    /// image names.
    fn photo_paths(
        &mut self,
        images: &[&ColmapImage],
        folder: &Path,
        finder: &mut Finder,
    ) -> Vec<Result<PathBuf>> {
        let list = self.list.clone();
        let mut paths: Vec<Result<PathBuf>> = images
            .iter()
            .map(|image| {
                let path = image.photo_path(folder, &list)?;
                Ok(finder.photo(folder, &plain(&image.name)).unwrap_or(path))
            })
            .collect();
        let is_there = |path: &&PathBuf| path.is_file();
        let named: HashSet<PathBuf> = paths.iter().flatten().filter(is_there).cloned().collect();
        let mut found = Vec::new();
        for (image, path) in images.iter().zip(&mut paths) {
            if path.as_ref().is_ok_and(|path| named.contains(path)) {
                continue;
            }
            match finder.photo_by_end(folder, &plain(&image.name)) {
                Ok(Some(photo)) if !named.contains(&photo) => {
                    found.push(format!("{} for {:?}", photo.display(), ending(&image.name)));
                    *path = Ok(photo);
                }
                Ok(_) => {}
                Err(two) => {
                    let [first, second] = two.map(|photo| photo.display().to_string());
                    let problem =
                        format!("the photo of {:?} may be {first} or {second}", ending(&image.name));
                    *path =
                        Err(Error::input(&list, problem, "put the photos into the folders that it names"));
                }
            }
        }
        if let Some(first) = found.first() {
            self.warnings.push(format!(
                "{}: {} of {} photos do not lie where it says: those whose paths end alike are taken, {first}",
                list.display(),
                found.len(),
                images.len()
            ));
        }
        paths
    }

    fn of_transforms(path: &Path, transforms: Transforms, options: &DatasetOptions) -> Result<Self> {
        let Transforms { source, mut frames, has_split, warnings, depth_maps, .. } = transforms;
        frames.sort_by(|a, b| a.name.cmp(&b.name));
        let mut plan = Self {
            list: source.clone(),
            source,
            views: Vec::new(),
            registered: frames.len(),
            has_split,
            frame: WorldFrame::default(),
            points: PointCloud::default(),
            cameras: BTreeMap::new(),
            warnings,
            notes: Vec::new(),
            named_depth_maps: depth_maps,
            distorted: None,
        };
        let mut finder = Finder::default();
        let paths: Vec<PathBuf> =
            frames.iter().map(|frame| photo_in_folder(path, frame, &options.images, &mut finder)).collect();
        if options.images != "images" && frames.iter().all(|frame| !frame.name.starts_with("images/")) {
            let problem = format!(
                "{} has no effect here: {} names photos outside of images/, {} for example",
                options.images,
                plan.list.display(),
                frames[0].name
            );
            return Err(Error::argument("images", problem));
        }
        let asked = frames.iter().zip(&paths).map(|(frame, path)| (Some(&**path), frame.optics.sides()));
        let turned = Turned::of(&asked.collect::<Vec<_>>(), options.orientation);
        plan.warnings.extend(turned.warning(&plan.list));
        let mut lenses = Lenses::new();
        let photos = turned.photos.into_iter().zip(turned.sizes);
        for (index, ((frame, photo_path), photo)) in frames.iter().zip(paths).zip(photos).enumerate() {
            let view = plan.frame(frame, photo_path, photo, &mut lenses).map(|view| PlannedView {
                image_id: index as u32,
                mask_path: view.mask_path.map(|named| mask_in_folder(path, &options.images, &named)),
                ..view
            });
            plan.views.push(view);
        }
        let sizes: Vec<String> = plan.cameras.keys().cloned().collect();
        if frames.iter().any(|frame| frame.optics.size.is_none()) && sizes.len() > 1 {
            let sizes = sizes.join(", ");
            plan.warnings.push(format!(
                "{}: the photos have several sizes, each its own camera: {sizes}",
                plan.list.display()
            ));
        }
        let known = lenses.values().map(|(lens, pinhole)| (lens, *pinhole));
        plan.distorted = lens_note::of(&plan.list, known);
        if !plan.has_split && frames.iter().all(|frame| frame.name.starts_with("images/")) {
            let folder = path.join(&options.images);
            plan.tell_of_photos_without_camera(photos_below(&folder), path, &folder);
        }
        Ok(plan)
    }

    fn frame(
        &mut self,
        frame: &Frame,
        photo_path: PathBuf,
        (turned, size): (bool, Option<(u32, u32)>),
        lenses: &mut Lenses,
    ) -> Result<PlannedView> {
        if !photo_path.is_file() {
            let problem = format!("the photo of frame {} is missing", frame.name);
            return Err(Error::input(
                photo_path,
                problem,
                "copy it there, or remove the frame from the file",
            ));
        }
        let (width, height) = match (frame.optics.size, size) {
            (Some([width, height]), _) => (width, height),
            (None, Some(size)) => size,
            (None, None) => header(&photo_path)?.size(turned),
        };
        let problem = |problem: String| {
            Error::input(&self.list, format!("frame {}: {problem}", frame.name), "correct the file")
        };
        let lens = frame.optics.lens(width, height);
        if let Some(what) = lens.intrinsics().absurdity() {
            return Err(problem(what));
        }
        // Frames share a few lenses, and fitting a distorted one is expensive.
        let known = lenses.entry(format!("{lens:?}"));
        let pinhole = known.or_insert_with(|| (lens, lens.inscribed_pinhole())).1;
        let kind = if lens.is_distorted() { "distorted" } else { "PINHOLE" };
        *self.cameras.entry(format!("{kind} {width}x{height}")).or_default() += 1;
        let pinhole = pinhole.ok_or_else(|| problem(format!("the camera {NO_PINHOLE}")))?;
        let camera =
            Camera::with_pose(frame.camera_from_source.as_mat3(), frame.translation.as_vec3(), pinhole);
        if let Some(what) = camera.problem().or_else(|| camera.absurdity()) {
            return Err(problem(what));
        }
        Ok(PlannedView {
            name: frame.name.clone(),
            camera_from_source: frame.camera_from_source,
            translation: frame.translation,
            mask_path: frame.mask_path.clone(),
            held_out: frame.test,
            ..PlannedView::of((lens, pinhole), photo_path, (turned, size))
        })
    }

    /// True if a view is held out.
    pub(super) fn is_test(&self, index: usize, options: &DatasetOptions) -> bool {
        let says_so = || self.views[index].as_ref().is_ok_and(|view| view.held_out);
        if self.has_split { options.eval && says_so() } else { options.is_test(index) }
    }

    /// Refuses a data set without views.
    pub(super) fn check_views(&self) -> Result<()> {
        let remedy = "run COLMAP's mapper again with more overlapping photos";
        let none = || Error::input(&self.list, "no images are registered", remedy);
        if self.views.is_empty() { Err(none()) } else { Ok(()) }
    }
}

/// Refuses a split that leaves no views to train on.
pub(super) fn check_split(list: &Path, held_out: &[bool]) -> Result<()> {
    if held_out.contains(&false) {
        return Ok(());
    }
    let problem = format!("all of its {} images are held out, none is left to train on", held_out.len());
    Err(Error::input(list, problem, "train without --eval"))
}

/// The photo of a frame; in the requested folder if the file names `images`.
fn photo_in_folder(path: &Path, frame: &Frame, images: &str, finder: &mut Finder) -> PathBuf {
    match frame.name.strip_prefix("images/") {
        Some(rest) if images != "images" => {
            let folder = path.join(images);
            finder.photo(&folder, rest).unwrap_or_else(|| folder.join(rest))
        }
        _ => frame.photo_path.clone(),
    }
}
