//! Where the photos of a COLMAP model lie.

use std::path::{Path, PathBuf};

use crate::names::{count_photos, count_photos_beside, has_photos};
use crate::{colmap, regular_file};
use ashsplat::{Error, Result};

/// The folder that is named; or the data set itself if it has no `images` and photos lie beside the model.
pub(super) fn find(dataset: &Path, images: &str) -> Result<PathBuf> {
    let folder = dataset.join(images);
    if folder.is_dir() {
        return Ok(folder);
    }
    if images == "images" && has_photos(dataset) {
        return Ok(dataset.to_owned());
    }
    let remedy = match has_photos(&dataset.join("input")) {
        true => "those in the folder input are used with --images input",
        false => "put the photos there, or name their folder with --images",
    };
    Err(Error::input(folder, "there is no folder with photos", remedy))
}

/// How many photos the folder has, whether or not they are in the model. In that of the data set itself other pictures
/// may lie beside them, masks for example: only the folders with photos of the model (`names`) are counted.
pub(super) fn count<'n>(dataset: &Path, folder: &Path, names: impl Iterator<Item = &'n str>) -> usize {
    match (dataset.canonicalize(), folder.canonicalize()) {
        (Ok(dataset), Ok(same)) if dataset == same => count_photos_beside(folder, names),
        _ => count_photos(folder),
    }
}

/// What may find cameras for the other photos of a data set.
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
