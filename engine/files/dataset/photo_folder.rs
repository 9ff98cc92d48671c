//! Finds the photos of a COLMAP model.

use std::path::{Path, PathBuf};

use crate::names::{has_photos, photos_below, photos_beside};
use crate::{colmap, regular_file};
use ashsplat::{Error, Result};

/// The named folder, or the data set itself if it has no `images` and photos lie beside the model.
pub(super) fn find(dataset: &Path, images: &str) -> Result<PathBuf> {
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

/// All photos of the folder, in the model or not. The data set's own folder may hold other pictures, such as masks:
/// there, only the folders with photos of the model (`names`) are searched.
pub(super) fn found<'n>(dataset: &Path, folder: &Path, names: impl Iterator<Item = &'n str>) -> Vec<PathBuf> {
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
