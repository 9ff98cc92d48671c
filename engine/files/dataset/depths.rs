//! The inverse-depth maps of a data set's photos.

use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use rayon::prelude::*;

use super::View;
use super::crop::cut;
use super::options::DatasetOptions;
use super::planned_view::{PlannedMap, PlannedView};
use crate::colmap::{self, ColmapImage, Model};
use crate::depth_fit::{DEPTH_PARAMS_FILE, DepthFit};
use crate::images::{DepthMap, header};
use crate::names::{Finder, plain, stays_inside};
use crate::transforms;
use ashsplat::scene::PicturePart;
use ashsplat::{Error, Result};

/// Finds the maps of the views that are trained on; none for those whose map cannot be fitted. `unit` is the frame's
/// unit in source units.
pub(super) fn plan(
    dataset: &Path,
    (views, unit): (&mut [PlannedView], f64),
    options: &DatasetOptions,
    warnings: &mut Vec<String>,
) -> Result<()> {
    let Some(folder) = &options.depths else { return Ok(()) };
    let trained: Vec<&PlannedView> = views.iter().filter(|view| view.is_trained(options)).collect();
    let maps = of_trained(dataset, folder, (&trained, unit, options), warnings)?;
    let trained = views.iter_mut().filter(|view| view.is_trained(options));
    trained.zip(maps).for_each(|(view, map)| view.map = map);
    Ok(())
}

/// Finds the maps of training views, in their order.
fn of_trained(
    dataset: &Path,
    folder: &Path,
    (views, unit, options): (&[&PlannedView], f64, &DatasetOptions),
    warnings: &mut Vec<String>,
) -> Result<Vec<Option<PlannedMap>>> {
    let folder = dataset.join(folder);
    if !folder.is_dir() {
        let remedy = "give -d the folder of the maps within the data set, or train without it";
        return Err(Error::input(folder, "is no folder with depth maps", remedy));
    }
    let mut finder = Finder::default();
    let found = views.iter().map(|view| checked_map_of(&folder, view, &mut finder));
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
    if transforms::find(dataset).is_some() && !colmap::exists(dataset) {
        // The maps of a transforms.json hold inverse depths.
        let fit = DepthFit { scale: unit, offset: 0.0 };
        return Ok(paths.into_iter().map(|path| Some(PlannedMap { path, fit })).collect());
    }
    let model = Model::of_dataset(dataset)?;
    let file = model.source.folder.join(DEPTH_PARAMS_FILE);
    let is_given = file.is_file();
    let fits = match is_given {
        true => given(&file, views, unit)?,
        false => {
            let fits = fitted(&model, (views, unit), &paths, options)?;
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
        return Err(Error::input(folder, problem, format!("write {}, or train without -d", file.display())));
    }
    if left_out > 0 {
        let first = views.iter().zip(&maps).find(|(_, map)| map.is_none()).map_or("", |(view, _)| &view.name);
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

/// A photo's name without its extension, as maps are named.
fn stem(name: &str) -> String {
    let name = plain(name);
    let ending = name.rsplit_once('.').filter(|(_, ending)| !ending.contains('/'));
    ending.map_or(name.clone(), |(stem, _)| stem.to_owned())
}

/// Finds the map of a photo. The maps' folder may omit folders of the photo's name.
pub(super) fn map_of(folder: &Path, name: &str, finder: &mut Finder) -> Option<PathBuf> {
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
    let (width, height) = header(&path)?.size(false);
    let (photo_width, photo_height) = (u64::from(view.lens.width), u64::from(view.lens.height));
    let apart = (u64::from(width) * photo_height).abs_diff(u64::from(height) * photo_width);
    // A smaller size is rounded to whole pixels.
    Ok((path, apart <= photo_width + photo_height))
}

/// Reads the parameters of a file and converts them from 1 / source units to 1 / world units.
fn given(file: &Path, views: &[&PlannedView], unit: f64) -> Result<Vec<DepthFit>> {
    let all: BTreeMap<String, DepthFit> = DepthFit::read_all(file)?;
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

fn fitted(
    model: &Model,
    (views, unit): (&[&PlannedView], f64),
    paths: &[PathBuf],
    options: &DatasetOptions,
) -> Result<Vec<(DepthFit, bool)>> {
    let mut observed = colmap::observations(model)?;
    observed.values_mut().flatten().for_each(|point| point.inverse_z *= unit);
    let size = |image: &ColmapImage| {
        let camera = model.cameras.get(&image.camera_id)?;
        Some((image.id, (u32::try_from(camera.width).ok()?, u32::try_from(camera.height).ok()?)))
    };
    let sizes: HashMap<u32, (u32, u32)> = model.images.iter().filter_map(size).collect();
    let fit = |(view, path): (&&PlannedView, &PathBuf)| {
        let id = view.image_id;
        let (Some(points), Some(size)) = (observed.get(&id), sizes.get(&id)) else {
            return Ok((DepthFit::default(), false));
        };
        Ok(DepthFit::of(&DepthMap::read(path, &options.host_memory)?, *size, points))
    };
    views.par_iter().zip(paths).map(fit).collect()
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
