//! Reads the contents of a data set into its plan: from COLMAP's models, transforms.json and photogrammetry programs.

use std::collections::{BTreeMap, HashSet};
use std::path::{Path, PathBuf};

use glam::DVec3;

use super::companions::mask_in_folder;
use super::plan::{Plan, UsedLenses};
use super::planned_view::{FileSize, PlannedView};
use super::{DatasetOptions, notes, photos};
use crate::colmap::{ColmapImage, Model};
use crate::images::photo_header;
use crate::names::{Finder, ending, photos_below, plain, stays_inside};
use crate::transforms::{Frame, Transforms};
use crate::{colmap, photogrammetry, transforms};
use ashsplat::scene::{Camera, Projection};
use ashsplat::{Error, Result};

/// Reads the contents of a data set. Finds the photos without decoding them; opens those of unknown size.
pub(super) fn plan(path: &Path, options: &DatasetOptions) -> Result<Plan> {
    let files = transforms::find(path);
    let unused = transforms::unused(path, if colmap::exists(path) { None } else { files.as_deref() });
    let (mut plan, mut points) = match files {
        Some(files) if !colmap::exists(path) => {
            let mut transforms = Transforms::read(&files)?;
            let points = std::mem::take(&mut transforms.points);
            (Plan::of_transforms(path, transforms, options)?, points)
        }
        _ => {
            let sources =
                if colmap::exists(path) { Vec::new() } else { photogrammetry::find(path, &options.images) };
            let mut model = match sources.as_slice() {
                [] => Model::of_dataset(path)?,
                [source] => {
                    let (folder, mut finder) =
                        (photos::find_folder(path, &options.images)?, Finder::default());
                    let mut size_of = |name: &str| photos::size(&folder, name, &mut finder);
                    photogrammetry::read(source, path, &mut size_of)?
                }
                several => {
                    let files: Vec<String> =
                        several.iter().map(|source| source.path().display().to_string()).collect();
                    let problem = format!("several files have cameras: {}", files.join(", "));
                    return Err(Error::input(path, problem, "leave one of them there"));
                }
            };
            let points = std::mem::take(&mut model.points);
            if sources.is_empty() {
                model.warnings.extend(colmap::contradiction(&model));
            }
            (Plan::of_model(path, &model, options)?, points)
        }
    };
    plan.fit_lenses(options);
    plan.warnings.extend(unused);
    plan.find_companions(path, options);
    if points.is_empty() {
        plan.warn_of_unread_points(path);
    }
    plan.turn_upright(options.level, &mut points);
    plan.settle_frame(options.frame, points);
    plan.settle_split(options);
    plan.warn_of_unused_files(path, options);
    plan.warn_of_strays();
    plan.warn_of_lenses();
    plan.warn_of_points_out_of_view();
    let size = |view: &PlannedView| (view.used.width, view.used.height);
    let sizes: Vec<(u32, u32)> = plan.views.iter().map(size).collect();
    plan.warnings.extend(notes::scaling_warning(&sizes, options.resolution));
    let distorted = plan.views.iter().filter(|view| view.lens.projection != Projection::Perspective);
    let distorted: Vec<_> = distorted.map(size).collect();
    let note = notes::distorted_photos(plan.distorted.as_deref(), &distorted, options);
    if options.undistort && plan.distorted.is_none() {
        plan.notes.push("all cameras are pinholes: --undistort changes nothing".into());
    }
    plan.notes.extend(note.or_else(|| notes::scaling_note(&sizes, options.resolution)));
    plan.note_shutters();
    Ok(plan)
}

impl Plan {
    fn of_model(path: &Path, model: &Model, options: &DatasetOptions) -> Result<Self> {
        let mut plan = Self {
            source: model.source.folder.clone(),
            list: model.file("images"),
            registered: model.images.len(),
            warnings: model.warnings.clone(),
            notes: model.notes.clone(),
            ..Self::default()
        };
        let mut images: Vec<&ColmapImage> = model.images.iter().collect();
        images.sort_by(|a, b| a.name.cmp(&b.name));
        let mut lenses = BTreeMap::new();
        for camera in model.cameras.values() {
            let kind = format!("{} {}x{}", camera.model.name(), camera.width, camera.height);
            *plan.cameras.entry(kind).or_default() += 1;
            // A problem of a camera is reported for the images that use it.
            if let Ok(lens) = model.lens(camera) {
                lenses.insert(camera.id, (lens, options.used_lens(&lens)));
            }
        }
        plan.distorted =
            notes::distorted_lenses(&model.file("cameras"), lenses.values().map(|(lens, _)| lens));
        let folder = match photos::find_folder(path, &options.images) {
            Ok(folder) => folder,
            Err(e) => return Ok(Self { problems: vec![(0, e)], ..plan }),
        };
        let mut finder = Finder::default();
        let paths = plan.photo_paths(&images, &folder, &mut finder);
        let requests = images.iter().zip(&paths).map(|(image, path)| {
            let camera = model.cameras.get(&image.camera_id);
            (path.as_deref().ok(), camera.map(|camera| [camera.width as f64, camera.height as f64]))
        });
        // COLMAP itself never rotates photos, so no warning is needed if no size shows otherwise.
        let (photos, _) = photos::turned(&requests.collect::<Vec<_>>(), options.orientation);
        let view = |((image, photo_path), photo): ((&ColmapImage, Result<PathBuf>), FileSize)| {
            model.camera_of(image)?;
            let Some(&(lens, Some(used))) = lenses.get(&image.camera_id) else {
                let place = format!("camera {}:", image.camera_id);
                return Err(photos::no_pinhole(&model.file("cameras"), &place));
            };
            let photo_path = photo_path?;
            if !photo_path.is_file() {
                let problem = format!("the photo of image {} is missing", image.id);
                let remedy = "copy it there, or remove the image from the model";
                return Err(Error::input(photo_path, problem, remedy));
            }
            // The name is shown and written. A path outside the photos' folder and a name without extension are replaced.
            let found = photo_path.strip_prefix(&folder).unwrap_or(&photo_path).to_string_lossy();
            let is_whole = stays_inside(&plain(&image.name)) && Path::new(&image.name).extension().is_some();
            let name = if is_whole { image.name.clone() } else { found.into_owned() };
            Ok(PlannedView {
                name,
                image_id: image.id,
                camera_id: image.camera_id,
                camera_from_source: image.rotation(),
                translation: DVec3::from_array(image.translation),
                ..PlannedView::of(lens, used, photo_path, photo)
            })
        };
        let names = images.iter().map(|image| image.name.as_str());
        plan.warn_of_photos_without_camera(photos::in_folder(path, &folder, names), path, &folder);
        images.into_iter().zip(paths).zip(photos).map(view).for_each(|view| plan.add(view));
        Ok(plan)
    }

    fn note_shutters(&mut self) {
        let (all, list) = (self.views.len(), self.list.display());
        let rolling = self.views.iter().filter(|view| view.shutter.is_some());
        let (count, bent) =
            rolling.fold((0, false), |(n, bent), view| (n + 1, bent || view.is_undistorted()));
        if count > 0 {
            self.notes.push(format!(
                "{list}: {count} of {all} photos have a rolling shutter, and are drawn with it"
            ));
        }
        if bent {
            self.warnings.push(format!(
                "{list}: --undistort bends the rows of a rolling shutter, which are taken as straight: leave it out"
            ));
        }
    }

    fn warn_of_photos_without_camera(&mut self, photos: Vec<PathBuf>, dataset: &Path, folder: &Path) {
        let registered = self.registered;
        let stems: HashSet<PathBuf> = photos.iter().map(|photo| photo.with_extension("")).collect();
        let (alike, photos) = (photos.len() - stems.len(), stems.len());
        if alike > 0 && photos + alike > registered {
            let (folder, list) = (folder.display(), self.list.display());
            self.warnings.push(format!(
                "{folder}: {alike} of its photos have the name of another one but for the ending: those that {list} names are used"
            ));
        }
        if photos > registered {
            // A file of another program is no folder of COLMAP's.
            let advice = match self.source.is_dir() {
                true => photos::advice_for_more(dataset),
                false => "the program that wrote the cameras left them out",
            };
            let folder = folder.display();
            self.warnings.push(format!(
                "{folder}: only {registered} of its {photos} photos have a camera: the others are not used ({advice})"
            ));
        }
    }

    /// Finds the photos of a model's images: by their names; if none matches, by the names' ends, among
    /// photos that no image names.
    fn photo_paths(
        &mut self,
        images: &[&ColmapImage],
        folder: &Path,
        finder: &mut Finder,
    ) -> Vec<Result<PathBuf>> {
        let list = self.list.clone();
        let path = |image: &&ColmapImage| {
            let path = image.photo_path(folder, &list)?;
            Ok(finder.photo(folder, &plain(&image.name)).unwrap_or(path))
        };
        let mut paths: Vec<Result<PathBuf>> = images.iter().map(path).collect();
        let named: HashSet<PathBuf> = paths.iter().flatten().filter(|path| path.is_file()).cloned().collect();
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
                    let ([first, second], name) =
                        (two.map(|photo| photo.display().to_string()), ending(&image.name));
                    let problem = format!("the photo of {name:?} may be {first} or {second}");
                    *path =
                        Err(Error::input(&list, problem, "put the photos into the folders that it names"));
                }
            }
        }
        if let Some(first) = found.first() {
            let (found, all) = (found.len(), images.len());
            self.warn(format!(
                "{found} of {all} photos do not lie where it says: those whose paths end alike are taken, {first}"
            ));
        }
        paths
    }

    fn of_transforms(path: &Path, transforms: Transforms, options: &DatasetOptions) -> Result<Self> {
        let Transforms { source, mut frames, has_split, warnings, depth_maps, note, .. } = transforms;
        frames.sort_by(|a, b| a.name.cmp(&b.name));
        let (registered, named_depth_maps) = (frames.len(), depth_maps);
        let mut plan = Self {
            list: source.clone(),
            source,
            registered,
            has_split,
            warnings,
            notes: vec![note],
            named_depth_maps,
            ..Self::default()
        };
        let mut finder = Finder::default();
        let paths: Vec<PathBuf> =
            frames.iter().map(|frame| photo_in_folder(path, frame, &options.images, &mut finder)).collect();
        if options.images != "images" && frames.iter().all(|frame| !frame.name.starts_with("images/")) {
            let (images, list, first) = (&options.images, plan.list.display(), &frames[0].name);
            let problem = format!(
                "{images} has no effect here: {list} names photos outside of images/, {first} for example"
            );
            return Err(Error::argument("images", problem));
        }
        let requests = frames.iter().zip(&paths).map(|(frame, path)| (Some(&**path), frame.optics.sides()));
        let (photos, undecided) = photos::turned(&requests.collect::<Vec<_>>(), options.orientation);
        plan.warnings.extend(photos::unknown_rotation(&plan.list, undecided));
        let mut lenses = UsedLenses::new(options);
        for (index, ((frame, photo_path), photo)) in frames.iter().zip(paths).zip(photos).enumerate() {
            let view = plan.frame(frame, photo_path, photo, &mut lenses).map(|view| PlannedView {
                image_id: index as u32,
                mask_path: view.mask_path.map(|named| mask_in_folder(path, &options.images, &named)),
                ..view
            });
            plan.add(view);
        }
        let sizes: Vec<String> = plan.cameras.keys().cloned().collect();
        if frames.iter().any(|frame| frame.optics.size.is_none()) && sizes.len() > 1 {
            plan.warn(format!("the photos have several sizes, each its own camera: {}", sizes.join(", ")));
        }
        plan.distorted = notes::distorted_lenses(&plan.list, lenses.known.values().map(|(lens, _)| lens));
        if !plan.has_split && frames.iter().all(|frame| frame.name.starts_with("images/")) {
            let folder = path.join(&options.images);
            plan.warn_of_photos_without_camera(photos_below(&folder), path, &folder);
        }
        Ok(plan)
    }

    fn frame(
        &mut self,
        frame: &Frame,
        photo_path: PathBuf,
        (turned, size): FileSize,
        lenses: &mut UsedLenses<'_>,
    ) -> Result<PlannedView> {
        if !photo_path.is_file() {
            let problem = format!("the photo of frame {} is missing", frame.name);
            let remedy = "copy it there, or remove the frame from the file";
            return Err(Error::input(photo_path, problem, remedy));
        }
        let (width, height) = match (frame.optics.size, size) {
            (Some([width, height]), _) => (width, height),
            (None, Some(size)) => size,
            (None, None) => photo_header(&photo_path)?.size(turned),
        };
        let problem = |problem: String| {
            Error::input(&self.list, format!("frame {}: {problem}", frame.name), "correct the file")
        };
        let lens = frame.optics.lens(width, height);
        if let Some(what) = lens.intrinsics().absurdity() {
            return Err(problem(what));
        }
        let used = lenses.of(lens);
        let kind =
            if lens.projection == Projection::Perspective { "PINHOLE" } else { lens.projection.name() };
        *self.cameras.entry(format!("{kind} {width}x{height}")).or_default() += 1;
        let Some(used) = used else {
            return Err(photos::no_pinhole(&self.list, &format!("frame {}: the camera", frame.name)));
        };
        let camera = used.camera(frame.camera_from_source.as_mat3(), frame.translation.as_vec3());
        let camera = Camera { shutter: frame.shutter, ..camera };
        if let Some(what) = camera.problem().or_else(|| camera.absurdity()) {
            return Err(problem(what));
        }
        Ok(PlannedView {
            name: frame.name.clone(),
            camera_from_source: frame.camera_from_source,
            translation: frame.translation,
            shutter: frame.shutter,
            mask_path: frame.mask_path.clone(),
            rim: frame.rim_px.map(|radius| radius / f64::from(width)),
            held_out: frame.test,
            ..PlannedView::of(lens, used, photo_path, (turned, size))
        })
    }
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
