//! Companion files of a data set's photos: masks and depth maps.

use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use rayon::prelude::*;

use crate::colmap::{ColmapImage, Model};
use crate::dataset::plan::Plan;
use crate::dataset::planned_view::{PlannedMap, PlannedView, cut};
use crate::dataset::{DatasetOptions, View};
use crate::depth_fit::{DEPTH_PARAMS_FILE, DepthFit, DepthMap};
use crate::images::photo_header;
use crate::names::{Finder, entries, is_companion, pictures_below, plain, stays_inside};
use crate::{colmap, transforms};
use ashsplat::scene::PicturePart;
use ashsplat::{Error, Result};

impl Plan {
    /// Finds the masks of all views without one. Notes how many have a mask or could have a depth map, and which files
    /// belong to no photo. Views that would share a photo or a mask because of a tolerant search become errors.
    pub(super) fn find_companions(&mut self, dataset: &Path, options: &DatasetOptions) {
        let images = dataset.join(&options.images);
        let mut finder = Finder::default();
        let folders = folders_of_masks(dataset, &options.images, &mut finder);
        let (mut photos, mut masks, mut twice) = (HashMap::new(), HashMap::new(), Vec::new());
        let list = self.list.clone();
        let shared = |what: &str, path: &Path, names: [&str; 2]| {
            let problem =
                format!("{} and {} would both have the {what} {}", names[0], names[1], path.display());
            Error::input(&list, problem, format!("give each a {what} whose path ends as its name does"))
        };
        self.refuse(|view| match photos.insert(view.photo_path.clone(), view.name.clone()) {
            Some(other) if other != view.name => Err(shared("photo", &view.photo_path, [&other, &view.name])),
            other => {
                twice.extend(other);
                Ok(())
            }
        });
        if let Some(first) = twice.first() {
            let count = twice.len();
            self.warn(format!("{count} photos have more than one pose, {first} for example: all are used"));
        }
        let name_of = |view: &PlannedView| {
            let below = |folder: &Path| view.photo_path.strip_prefix(folder).ok();
            below(&images).or_else(|| below(dataset)).unwrap_or(&view.photo_path).to_path_buf()
        };
        let names: Vec<PathBuf> = self.views.iter().map(name_of).collect();
        self.refuse(|view| {
            if let Some(mask) = &view.mask_path {
                masks.insert(mask.clone(), view.name.clone());
                return Ok(());
            }
            let mask = mask_of(&folders, &name_of(view), &view.photo_path, &mut finder);
            view.mask_path = mask.filter(|mask| !photos.contains_key(mask));
            let Some(mask) = &view.mask_path else { return Ok(()) };
            let other = masks.insert(mask.clone(), view.name.clone());
            other.map_or(Ok(()), |other| Err(shared("mask", mask, [&other, &view.name])))
        });
        let used: HashSet<&Path> = photos.keys().chain(masks.keys()).map(PathBuf::as_path).collect();
        self.note_masks(&images, &folders, &used);
        for folder in unused_folders(dataset, &folders, !masks.is_empty()) {
            let pictures = pictures_below(&folder).len();
            if pictures > 0 && !used.iter().any(|file| file.starts_with(&folder)) {
                let folder = folder.display();
                self.warnings.push(format!(
                    "{folder}: its {pictures} pictures are not used; masks that are to count lie in masks/, white where pixels count"
                ));
            }
        }
        if options.depths.is_none() {
            self.note_depth_maps(dataset, &names, &mut finder);
        }
    }

    fn note_masks(&mut self, images: &Path, folders: &[PathBuf], used: &HashSet<&Path>) {
        let all = self.views.len();
        let masks: Vec<&Path> = self.views.iter().filter_map(|view| view.mask_path.as_deref()).collect();
        if let Some(folder) = masks.first().and_then(|mask| mask.parent()) {
            let (count, folder) = (masks.len(), folder.display());
            self.notes.push(format!("{count} of {all} photos have a mask, the first in {folder}"));
        }
        let names_mask = |path: &Path| path.to_string_lossy().to_lowercase().contains("mask");
        let mut unused: Vec<PathBuf> =
            match folders.iter().find(|folder| masks.iter().any(|mask| mask.starts_with(folder))) {
                Some(folder) => pictures_below(folder),
                None => folders.iter().flat_map(|folder| pictures_below(folder)).collect(),
            };
        if images.is_dir() {
            let below = |path: &PathBuf| {
                path.strip_prefix(images).is_ok_and(|path| is_companion(path) && names_mask(path))
            };
            unused.extend(pictures_below(images).into_iter().filter(below));
        }
        unused.retain(|mask| !used.contains(mask.as_path()));
        if let Some(first) = unused.iter().min() {
            let (count, first) = (unused.len(), first.display());
            self.warnings.push(format!(
                "masks that belong to no photo with a camera are not used ({count}, {first} for example); that of a.jpg is called a.png, \
                 a.jpg.png, a_mask.png or mask_a.png"
            ));
        }
    }

    /// Notes depth maps that are present but unused: only `-d` uses them.
    fn note_depth_maps(&mut self, dataset: &Path, names: &[PathBuf], finder: &mut Finder) {
        if self.named_depth_maps > 0 {
            let (list, count) = (self.list.display(), self.named_depth_maps);
            self.notes.push(format!(
                "{list}: the depth maps of its {count} depth_file_path are not used: -d reads inverse depths, 65536 / depth in 16 bits, \
                 which is 65536000 / value for maps in mm where the unit is 1 m"
            ));
            return;
        }
        for folder in folders_in(dataset, |name| name.contains("depth")) {
            let has_map = |name: &&PathBuf| map_of(&folder, &name.to_string_lossy(), finder).is_some();
            let (maps, all) = (names.iter().filter(has_map).count(), names.len());
            let (place, name) = (folder.display(), folder.file_name().unwrap_or_default().to_string_lossy());
            self.notes.push(match maps {
                0 => format!("{place}: holds no depth maps that -d reads: 16-bit PNGs called after their photos"),
                _ => format!("{place}: has depth maps for {maps} of {all} photos; only -d {name} uses them, as inverse depths"),
            });
        }
    }
}

const FOLDERS: [&str; 7] =
    ["masks", "mask", "segmentation", "segmentations", "segmentation_masks", "image_masks", "images_masks"];

/// The folders of a data set that hold masks. The one of the photos' folder comes first: `masks_4` with `images_4`.
fn folders_of_masks(dataset: &Path, images: &str, finder: &mut Finder) -> Vec<PathBuf> {
    let ending = ending_of(images);
    let beside_photos = dataset.join(images).parent().map_or(dataset.to_owned(), Path::to_owned);
    let mut folders = Vec::new();
    for ending in [ending, ""] {
        for place in [&*beside_photos, dataset] {
            folders
                .extend(FOLDERS.iter().filter_map(|name| finder.folder(place, &format!("{name}{ending}"))));
        }
    }
    let mut known = HashSet::new();
    folders.retain(|folder| known.insert(folder.clone()));
    folders
}

/// Unused folders with names like masks, such as `sky_masks`, which other programs combine with other masks. Masks of other
/// sizes, such as `masks_2`, are among them unless there are masks in use.
fn unused_folders(dataset: &Path, used: &[PathBuf], has_masks: bool) -> Vec<PathBuf> {
    let is_known = |name: &str| {
        let stem = name.trim_end_matches(|c: char| c.is_ascii_digit()).trim_end_matches('_');
        FOLDERS.contains(&stem)
    };
    let is_other =
        |name: &str| name.contains("mask") && !(has_masks && is_known(name)) && !name.starts_with('.');
    let mut folders = folders_in(dataset, is_other);
    folders.retain(|folder| !used.contains(folder));
    folders
}

/// Folders in a folder, by their names in lower case, sorted.
fn folders_in(folder: &Path, fits: impl Fn(&str) -> bool) -> Vec<PathBuf> {
    let named = entries(folder).filter(|entry| fits(&entry.file_name().to_string_lossy().to_lowercase()));
    let mut folders: Vec<PathBuf> = named.map(|entry| entry.path()).filter(|path| path.is_dir()).collect();
    folders.sort_unstable();
    folders
}

/// Finds the mask of a photo, whose path below the photos' folder is `name`. It lies beside the photo, or in a folder
/// of masks below the same subfolders or fewer.
fn mask_of(folders: &[PathBuf], name: &Path, photo: &Path, finder: &mut Finder) -> Option<PathBuf> {
    let whole = name.file_name()?.to_str()?;
    let stem = name.file_stem()?.to_str()?;
    // The name that COLMAP uses, then those of Metashape, 3DGRUT and RealityCapture.
    let [own, plain] = [format!("{whole}.png"), format!("{stem}.png")];
    let marked = [
        format!("{stem}_mask.png"),
        format!("{whole}_mask.png"),
        format!("mask_{stem}.png"),
        format!("{stem}.mask.png"),
        format!("{whole}.mask.png"),
        format!("{stem}-mask.png"),
    ];
    let in_folder = || [&own, &plain].into_iter().chain(&marked);
    let parts: Vec<_> = name.parent().unwrap_or(Path::new("")).iter().collect();
    for folder in folders {
        for skipped in 0..=parts.len() {
            let place = parts[skipped..].iter().collect::<PathBuf>();
            for name in in_folder() {
                let found = finder.photo(folder, place.join(name).to_str()?);
                if found.is_some() {
                    return found;
                }
            }
        }
    }
    let beside = photo.parent()?;
    let inner: Vec<PathBuf> = FOLDERS[..2].iter().filter_map(|name| finder.folder(beside, name)).collect();
    let found = inner.iter().find_map(|folder| in_folder().find_map(|name| finder.photo(folder, name)));
    found.or_else(|| [&own].into_iter().chain(&marked).find_map(|name| finder.photo(beside, name)))
}

/// The counterpart of a named mask in the folder that matches the photos' folder, such as `masks_4` for photos in `images_4`, if it
/// exists; otherwise the mask that `transforms.json` names.
pub(super) fn mask_in_folder(dataset: &Path, images: &str, named: &Path) -> PathBuf {
    let rest = named.strip_prefix(dataset.join("masks")).ok();
    let folder = dataset.join(format!("masks{}", ending_of(images)));
    let beside = rest.map(|rest| folder.join(rest)).filter(|path| path.is_file());
    beside.unwrap_or_else(|| named.to_owned())
}

/// `_4` for `images_4`.
fn ending_of(images: &str) -> &str {
    images.trim_end_matches(std::path::is_separator).strip_prefix("images").unwrap_or_default()
}

impl Plan {
    /// Finds the maps of the views that are trained on; none for those whose map cannot be fitted.
    pub(super) fn find_depth_maps(&mut self, dataset: &Path, options: &DatasetOptions) -> Result<()> {
        let Some(folder) = &options.depths else { return Ok(()) };
        let folder = dataset.join(folder);
        if !folder.is_dir() {
            let remedy = "give -d the folder of the maps within the data set, or train without it";
            return Err(Error::input(folder, "is no folder with depth maps", remedy));
        }
        let trained: Vec<&PlannedView> = self.views.iter().filter(|view| view.is_trained(options)).collect();
        let paths = map_paths(&folder, &trained, &mut self.warnings)?;
        let maps = match transforms::find(dataset).is_some() && !colmap::exists(dataset) {
            // The maps of a transforms.json hold inverse depths.
            true => {
                let fit = DepthFit { scale: self.frame.unit, offset: 0.0 };
                paths.into_iter().map(|path| Some(PlannedMap { path, fit })).collect()
            }
            false => {
                let fits =
                    MapFits { model: Model::of_dataset(dataset)?, folder, unit: self.frame.unit, options };
                fits.of(&trained, paths, &mut self.warnings)?
            }
        };
        let trained = self.views.iter_mut().filter(|view| view.is_trained(options));
        trained.zip(maps).for_each(|(view, map)| view.map = map);
        Ok(())
    }
}

/// Paths of the maps of views, in their order.
fn map_paths(folder: &Path, views: &[&PlannedView], warnings: &mut Vec<String>) -> Result<Vec<PathBuf>> {
    let mut finder = Finder::default();
    let found = views.iter().map(|view| checked_map_of(folder, view, &mut finder));
    let (paths, shapes): (Vec<PathBuf>, Vec<bool>) = found.collect::<Result<_>>()?;
    let mut known = HashMap::new();
    if let Some((view, path, other)) =
        views.iter().zip(&paths).find_map(|(view, path)| Some((view, path, known.insert(path, &view.name)?)))
    {
        let problem = format!("{other} and {} would both have the depth map {}", view.name, path.display());
        return Err(Error::input(folder, problem, "give each a map whose path ends as its name does"));
    }
    let of_other_shape = || paths.iter().zip(&shapes).filter(|(_, has_shape)| !**has_shape);
    if let Some((first, _)) = of_other_shape().next() {
        let (count, all) = (of_other_shape().count(), paths.len());
        warnings.push(format!(
            "{}: {count} of {all} depth maps are not of their photos' shape, this one first: they are stretched to it, not cut",
            first.display()
        ));
    }
    Ok(paths)
}

/// How the values of maps become inverse depths: by a file beside the model, or by its sparse points.
struct MapFits<'a> {
    model: Model,
    folder: PathBuf,
    /// World unit, source units.
    unit: f64,
    options: &'a DatasetOptions,
}

impl MapFits<'_> {
    fn of(
        &self,
        views: &[&PlannedView],
        paths: Vec<PathBuf>,
        warnings: &mut Vec<String>,
    ) -> Result<Vec<Option<PlannedMap>>> {
        let folder = &self.folder;
        let file = self.model.source.folder.join(DEPTH_PARAMS_FILE);
        let is_given = file.is_file();
        let fits = match is_given {
            true => self.given(&file, views)?,
            false => {
                let fits = self.fitted(views, &paths)?;
                let falling = fits.iter().filter(|(_, falls)| *falls).count();
                if 2 * falling > fits.len() {
                    let (folder, all) = (folder.display(), fits.len());
                    warnings.push(format!(
                    "{folder}: {falling} of {all} depth maps fall where the sparse points come nearer: -d reads inverse depths, and these \
                     look like depths"
                ));
                }
                fits.into_iter().map(|(fit, _)| fit).collect()
            }
        };
        let median = DepthFit::median_scale(&fits);
        let reliable =
            |(path, fit): (PathBuf, DepthFit)| fit.is_reliable(median).then_some(PlannedMap { path, fit });
        let maps: Vec<_> = paths.into_iter().zip(fits).map(reliable).collect();
        let left_out = maps.iter().filter(|map| map.is_none()).count();
        if left_out == maps.len() && left_out > 0 {
            if is_given {
                let remedy = "correct it, or remove it: then all are fitted";
                return Err(Error::input(file, "has no scale above 0 for any photo", remedy));
            }
            let problem =
                "none of the depth maps could be scaled: their photos show too few of the sparse points";
            return Err(Error::input(
                folder,
                problem,
                format!("write {}, or train without -d", file.display()),
            ));
        }
        if left_out > 0 {
            let first =
                views.iter().zip(&maps).find(|(_, map)| map.is_none()).map_or("", |(view, _)| &view.name);
            let why = match is_given {
                true => format!("in {} their scale is not above 0, or far from the others'", file.display()),
                false => "their scale is far from the others', or too few sparse points tell it".into(),
            };
            let (folder, all) = (folder.display(), maps.len());
            warnings.push(format!(
                "{folder}: {left_out} of {all} depth maps are left out, the first of photo {first}: {why}"
            ));
        }
        Ok(maps)
    }

    /// Reads the parameters of a file and converts them from 1 / source units to 1 / world units.
    fn given(&self, file: &Path, views: &[&PlannedView]) -> Result<Vec<DepthFit>> {
        let (all, unit) = (DepthFit::read_all(file)?, self.unit);
        let of = |view: &&PlannedView| {
            let fit = all.get(&stem(&view.name));
            let fit = fit.map(|fit| DepthFit { scale: unit * fit.scale, offset: unit * fit.offset });
            fit.ok_or_else(|| {
                let remedy = "add them, or remove the file: then all are fitted to the sparse points";
                Error::input(file, format!("has no scale and offset for photo {}", view.name), remedy)
            })
        };
        views.iter().map(of).collect()
    }

    /// Each fit, and true if the map holds depths.
    fn fitted(&self, views: &[&PlannedView], paths: &[PathBuf]) -> Result<Vec<(DepthFit, bool)>> {
        let mut observed = colmap::observations(&self.model)?;
        observed.values_mut().flatten().for_each(|point| point.inverse_z *= self.unit);
        let size = |image: &ColmapImage| {
            let camera = self.model.cameras.get(&image.camera_id)?;
            Some((image.id, (u32::try_from(camera.width).ok()?, u32::try_from(camera.height).ok()?)))
        };
        let sizes: HashMap<u32, (u32, u32)> = self.model.images.iter().filter_map(size).collect();
        let fit = |(view, path): (&&PlannedView, &PathBuf)| {
            let id = view.image_id;
            let (Some(points), Some(size)) = (observed.get(&id), sizes.get(&id)) else {
                return Ok((DepthFit::default(), false));
            };
            Ok(DepthFit::of(&DepthMap::read(path, &self.options.host_memory)?, *size, points))
        };
        views.par_iter().zip(paths).map(fit).collect()
    }
}

/// A photo's name without its extension, as maps are named.
fn stem(name: &str) -> String {
    let name = plain(name);
    let ending = name.rsplit_once('.').filter(|(_, ending)| !ending.contains('/'));
    ending.map_or(name.clone(), |(stem, _)| stem.to_owned())
}

/// Finds the map of a photo. The maps' folder may omit folders of the photo's name.
fn map_of(folder: &Path, name: &str, finder: &mut Finder) -> Option<PathBuf> {
    let (name, stem) = (plain(name), stem(name));
    let (below, last) = stem.rsplit_once('/').map_or(("", &*stem), |(below, last)| (below, last));
    let maps = [
        format!("{stem}.png"),
        format!("{name}.png"),
        format!("{below}/{last}_depth.png"),
        format!("{below}/depth_{last}.png"),
    ];
    let maps = || maps.iter().map(|map| map.trim_start_matches('/'));
    let found = maps().find_map(|map| finder.file(folder, map).filter(|_| stays_inside(map)));
    found.or_else(|| maps().find_map(|map| finder.file_by_end(folder, map)))
}

/// The map of a view, and true if it has the shape of its photo.
fn checked_map_of(folder: &Path, view: &PlannedView, finder: &mut Finder) -> Result<(PathBuf, bool)> {
    let name = view.name.strip_prefix("images/").unwrap_or(&view.name);
    let Some(path) = map_of(folder, name, finder) else {
        let problem = format!("the depth map of photo {} is missing", view.name);
        let path = folder.join(format!("{}.png", stem(name)));
        return Err(Error::input(path, problem, "compute it, or train without -d"));
    };
    if view.is_undistorted() {
        let problem = format!("photo {} is undistorted, which depth maps do not follow", view.name);
        return Err(Error::input(path, problem, "train without --undistort"));
    }
    if view.lens.projection.orders_by_distance() {
        let problem =
            format!("photo {} is of a fisheye or a panorama, whose depths may be of two kinds", view.name);
        return Err(Error::input(path, problem, "train without -d"));
    }
    let (width, height) = photo_header(&path)?.size(false);
    let (photo_width, photo_height) = (u64::from(view.lens.width), u64::from(view.lens.height));
    let apart = (u64::from(width) * photo_height).abs_diff(u64::from(height) * photo_width);
    // A smaller size is rounded to whole pixels.
    Ok((path, apart <= photo_width + photo_height))
}

impl PlannedMap {
    /// Reads the inverse depth of each pixel of a view's photo: infinite where the mask hides the pixel.
    pub(super) fn load(&self, view: &View, options: &DatasetOptions) -> Result<Arc<[f32]>> {
        let map = DepthMap::read(&self.path, &options.host_memory)?;
        let (photo, whole) = (&view.photo, view.camera.whole());
        let mut values = map.resized(whole.width, whole.height).values;
        if let Some(PicturePart { left, top, .. }) = view.camera.part {
            values = cut(&values, (whole.width, 1), [left, top], [photo.width, photo.height]);
        }
        let DepthFit { scale, offset } = self.fit;
        values.iter_mut().for_each(|value| *value = (scale * f64::from(*value) + offset) as f32);
        if let Some(mask) = photo.mask()? {
            let hidden = values.iter_mut().zip(mask.iter()).filter(|(_, counts)| **counts == 0);
            hidden.for_each(|(value, _)| *value = f32::INFINITY);
        }
        Ok(values.into())
    }
}
