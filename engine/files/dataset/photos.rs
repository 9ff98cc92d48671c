//! Finds the photos of a data set, and which of them are rotated or scaled.

use std::collections::HashSet;
use std::path::{Path, PathBuf};

use rayon::prelude::*;

use super::DatasetOptions;
use super::plan::{Plan, UsedLenses};
use super::planned_view::{FileSize, PlannedView, is_scaled};
use crate::images::{PhotoHeader, PhotoOrientation, photo_header};
use crate::names::{Finder, ending, has_photos, photos_below, photos_beside, plain, stays_inside};
use crate::{colmap, regular_file};
use ashsplat::{Error, Result};

/// The named folder, or the data set itself if it has no `images` and photos lie beside the model.
pub(super) fn find_folder(dataset: &Path, images: &str) -> Result<PathBuf> {
    let folder = dataset.join(images);
    if folder.is_dir() {
        return Ok(folder);
    }
    if images == "images" && has_photos(dataset) {
        return Ok(dataset.to_owned());
    }
    let usual = ["input", "images_2", "images_4", "images_8", "image", "photos", "frames", "rgb"];
    let remedy = match usual.iter().find(|name| has_photos(&dataset.join(name))) {
        Some(name) => format!("those in the folder {name} are used with --images {name}"),
        None => "put the photos there, or name their folder with --images".into(),
    };
    Err(Error::input(folder, "there is no folder with photos", remedy))
}

/// The error of a lens that no pinhole can replace. `place` names it in its file.
pub(super) fn no_pinhole(file: &Path, place: &str) -> Error {
    let problem = format!(
        "{place} sees too much for a pinhole, or its distortion folds the photo over, so that one place appears twice"
    );
    Error::input(file, problem, "train without --undistort")
}

/// Width and height of the photo with this name or path, as stored, pixels.
pub(super) fn size(folder: &Path, name: &str, finder: &mut Finder) -> Result<(u32, u32)> {
    let name = plain(name);
    let found = match stays_inside(&name) {
        true => finder.photo(folder, &name),
        false => finder.photo_by_end(folder, &name).ok().flatten(),
    };
    let missing = || {
        let problem = format!("has no photo {:?}, or several", ending(&name));
        Error::input(folder, problem, "copy it there, or remove its camera")
    };
    Ok(photo_header(&found.ok_or_else(missing)?)?.size(false))
}

/// All photos of the folder, in the model or not. The data set's own folder may hold other pictures, such as masks:
/// there, only the folders with photos of the model (`names`) are searched.
pub(super) fn in_folder<'n>(
    dataset: &Path,
    folder: &Path,
    names: impl Iterator<Item = &'n str>,
) -> Vec<PathBuf> {
    match (dataset.canonicalize(), folder.canonicalize()) {
        (Ok(dataset), Ok(same)) if dataset == same => photos_beside(folder, names),
        _ => photos_below(folder),
    }
}

/// Advice on how to find cameras for the other photos of a data set.
pub(super) fn advice_for_more(dataset: &Path) -> &'static str {
    match regular_file::read(dataset.join(colmap::POSES_LOG), 2) {
        Ok(log) if String::from_utf8_lossy(&log).contains(" exhaustive_matcher ") => {
            "all were compared with each other: photos that overlap more may register them"
        }
        Ok(_) => {
            "photos that overlap more, or `ashsplat poses --matcher exhaustive` into another folder, may register them"
        }
        Err(_) => "photos that overlap more, or `colmap exhaustive_matcher`, may register them",
    }
}

impl Plan {
    /// Scales the cameras of views to their photos. Photos of other proportions, or of another size than other photos of
    /// the same camera, are refused. Warns, unless the photos' folder is named after the ratio (`divisor`).
    pub(super) fn fit_lenses(&mut self, options: &DatasetOptions) {
        let divisor = options.divisor();
        let key = |view: &PlannedView| format!("{} {:?}", view.camera_id, view.lens);
        let own_size = |view: &PlannedView| (view.lens.width, view.lens.height);
        let unscaled = self.views.iter().filter(|view| view.file_size == Some(own_size(view)));
        let unscaled: HashSet<String> = unscaled.map(key).collect();
        let mut lenses = UsedLenses::new(options);
        let (mut first, mut count, mut as_named) = (None, 0, divisor > 1);
        self.refuse(|view| {
            let own = own_size(view);
            let Some((width, height)) = view.file_size.filter(|&size| size != own) else { return Ok(()) };
            let rounded = width.abs_diff(own.0) <= 1 && height.abs_diff(own.1) <= 1;
            if !is_scaled((width, height), own) || unscaled.contains(&key(view)) && !rounded {
                return Err(of_another_size(view, (width, height)));
            }
            first.get_or_insert(((width, height), own));
            count += 1;
            let divided = |side: u32, own: u32| side == own / divisor || side == own.div_ceil(divisor);
            as_named &= divided(width, own.0) && divided(height, own.1);
            let lens = view.lens.scaled_to(width, height);
            let used = lenses.of(lens);
            let used = used.ok_or_else(|| no_pinhole(&view.photo_path, "its camera at the photo's size"))?;
            (view.lens, view.used) = (lens, used);
            Ok(())
        });
        if let Some(((w, h), (width, height))) = first.filter(|_| !as_named) {
            self.warn(format!(
            "{count} photos are not of their camera's size, {w}x{h} and {width}x{height} for example: the cameras are scaled to them"
        ));
        }
    }
}

fn of_another_size(view: &PlannedView, (width, height): (u32, u32)) -> Error {
    let (w, h) = (view.lens.width, view.lens.height);
    let how = if view.turned { " when turned as its metadata say" } else { "" };
    let problem = format!("is {width}x{height} pixels{how}, its camera {w}x{h}");
    let remedy = if is_scaled((width, height), (w, h)) {
        "scale all photos of this camera, or none"
    } else if is_scaled((height, width), (w, h)) {
        "turn it on its side, as it was when the cameras were computed"
    } else {
        "use the pictures that the cameras were computed from, or whole ones scaled"
    };
    Error::input(&view.photo_path, problem, remedy)
}

/// Width and height of a camera, or values in proportion to them.
type Sides = [f64; 2];

/// Decides the rotation of photos (if they exist) by the sides of their cameras (if they are known). The second value
/// is the number of photos that are used as stored although their metadata ask for a rotation: no size decides it.
pub(super) fn turned(
    photos: &[(Option<&Path>, Option<Sides>)],
    choice: PhotoOrientation,
) -> (Vec<FileSize>, usize) {
    // A photo that cannot be read is reported when it is loaded.
    let header_of = |&(path, _): &(Option<&Path>, _)| photo_header(path?).ok();
    let headers: Vec<Option<PhotoHeader>> = photos.par_iter().map(header_of).collect();
    // For a photo whose metadata ask for a rotation: what its size tells, if anything.
    let reported = |index: usize| -> Option<Option<bool>> {
        let header = headers[index].filter(PhotoHeader::has_orientation)?;
        Some(photos[index].1.and_then(|sides| rotation_by_size(header, sides)))
    };
    let all = || (0..photos.len()).filter_map(reported);
    let [stored, turned] = [false, true].map(|turned| all().any(|reported| reported == Some(turned)));
    let decides = stored != turned || choice != PhotoOrientation::Auto;
    let undecided = if decides { 0 } else { all().filter(Option::is_none).count() };
    let is_turned = |index: usize| match choice {
        PhotoOrientation::Stored => false,
        PhotoOrientation::Upright => reported(index).is_some(),
        PhotoOrientation::Auto => {
            reported(index).is_some_and(|reported| reported.unwrap_or(turned && !stored))
        }
    };
    let photo = |(index, header): (usize, &Option<PhotoHeader>)| {
        let turned = is_turned(index);
        (turned, header.map(|header| header.size(turned)))
    };
    (headers.iter().enumerate().map(photo).collect(), undecided)
}

/// A warning if no size decides the rotation of some photos.
pub(super) fn unknown_rotation(list: &Path, undecided: usize) -> Option<String> {
    let list = list.display();
    let photos = match undecided {
        0 => return None,
        1 => "1 photo is".to_owned(),
        undecided => format!("{undecided} photos are"),
    };
    Some(format!(
        "{list}: {photos} to be turned by their metadata (Exif), and no size of a camera tells whether that was done \
             before the cameras were computed: taken as stored, as COLMAP, nerfstudio and instant-ngp take them; \
             --orientation upright turns them"
    ))
}

/// True if a camera has the size of the rotated photo; `None` if its sides fit both.
fn rotation_by_size(header: PhotoHeader, [width, height]: Sides) -> Option<bool> {
    let (stored_width, stored_height) = header.size(false);
    let tells = header.lies_on_its_side() && stored_width != stored_height && width != height;
    tells.then_some((width > height) != (stored_width > stored_height))
}
