//! Companion files of a data set's photos: masks and depth maps.

use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};

use super::DatasetOptions;
use super::depths::map_of;
use super::mask::{folders_of_masks, mask_of, unused_folders};
use super::plan::Plan;
use crate::names::{Finder, is_companion, pictures_below};
use ashsplat::Error;

impl Plan {
    /// Finds the masks of all views without one. Notes how many have a mask or could have a depth map, and which files
    /// belong to no photo. Views that would share a photo or a mask because of a tolerant search become errors.
    pub(super) fn find_companions(&mut self, dataset: &Path, options: &DatasetOptions) {
        let images = dataset.join(&options.images);
        let mut finder = Finder::default();
        let folders = folders_of_masks(dataset, &options.images, &mut finder);
        let (mut photos, mut masks) = (HashMap::new(), HashMap::new());
        let (mut names, mut twice) = (Vec::new(), Vec::new());
        let list = self.list.clone();
        let shared = |what: &str, path: &Path, names: [&str; 2]| {
            let problem =
                format!("{} and {} would both have the {what} {}", names[0], names[1], path.display());
            Error::input(&list, problem, format!("give each a {what} whose path ends as its name does"))
        };
        for view in &mut self.views {
            let Ok(found) = view else { continue };
            if let Some(other) = photos.insert(found.photo_path.clone(), found.name.clone()) {
                if other != found.name {
                    *view = Err(shared("photo", &found.photo_path, [&other, &found.name]));
                    continue;
                }
                twice.push(other);
            }
            let below = |folder: &Path| found.photo_path.strip_prefix(folder).ok();
            let name = below(&images).or_else(|| below(dataset)).unwrap_or(&found.photo_path).to_path_buf();
            names.push(name);
        }
        if let Some(first) = twice.first() {
            let (list, count) = (list.display(), twice.len());
            self.warnings.push(format!(
                "{list}: {count} photos have more than one pose, {first} for example: all are used"
            ));
        }
        let found = self.views.iter_mut().filter(|view| view.is_ok()).zip(&names);
        for (view, name) in found {
            let Ok(of_view) = view else { continue };
            if of_view.mask_path.is_some() {
                masks.insert(of_view.mask_path.clone().unwrap_or_default(), of_view.name.clone());
                continue;
            }
            let mask = mask_of(&folders, name, &of_view.photo_path, &mut finder);
            of_view.mask_path = mask.filter(|mask| !photos.contains_key(mask));
            let Some(mask) = of_view.mask_path.clone() else { continue };
            if let Some(other) = masks.insert(mask.clone(), of_view.name.clone()) {
                *view = Err(shared("mask", &mask, [&other, &of_view.name]));
            }
        }
        let used: HashSet<&Path> = photos.keys().chain(masks.keys()).map(PathBuf::as_path).collect();
        self.tell_of_masks(&images, &folders, &used);
        for folder in unused_folders(dataset, &folders, !masks.is_empty()) {
            let pictures = pictures_below(&folder).len();
            if pictures > 0 && !used.iter().any(|file| file.starts_with(&folder)) {
                self.warnings.push(format!(
                    "{}: its {pictures} pictures are not used; masks that are to count lie in masks/, white where pixels count",
                    folder.display()
                ));
            }
        }
        if options.depths.is_none() {
            self.tell_of_depths(dataset, &names, &mut finder);
        }
    }

    fn tell_of_masks(&mut self, images: &Path, folders: &[PathBuf], used: &HashSet<&Path>) {
        let all = self.views.iter().flatten().count();
        let masks: Vec<&Path> =
            self.views.iter().flatten().filter_map(|view| view.mask_path.as_deref()).collect();
        if let Some(folder) = masks.first().and_then(|mask| mask.parent()) {
            self.notes.push(format!(
                "{} of {all} photos have a mask, the first in {}",
                masks.len(),
                folder.display()
            ));
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
            self.warnings.push(format!(
                "masks that belong to no photo with a camera are not used ({}, {} for example); that of a.jpg is called a.png, \
                 a.jpg.png, a_mask.png or mask_a.png",
                unused.len(),
                first.display()
            ));
        }
    }

    /// Names point files that are not read, if the data set has no other points.
    pub(super) fn tell_of_points(&mut self, dataset: &Path) {
        const ENDINGS: [&str; 8] = ["las", "laz", "e57", "pts", "ptx", "xyz", "pcd", "ply"];
        // Beside a transforms.json, any PLY is used or named already.
        let endings = if self.source == self.list { &ENDINGS[..7] } else { &ENDINGS[..] };
        let is_points = |path: &PathBuf| {
            path.extension().is_some_and(|own| endings.iter().any(|ending| own.eq_ignore_ascii_case(ending)))
        };
        let entries = std::fs::read_dir(dataset).into_iter().flatten().flatten().map(|entry| entry.path());
        if let Some(file) = entries.filter(is_points).min() {
            let target = match self.source == self.list {
                true => dataset.join("points3d.ply"),
                false => self.source.join("points3D.ply"),
            };
            self.warnings.push(format!(
                "{}: its points are not used; save them in the cameras' coordinates as {} (CloudCompare and PDAL write PLY)",
                file.display(),
                target.display()
            ));
        }
    }

    /// Notes depth maps that are present but unused: only `-d` uses them.
    fn tell_of_depths(&mut self, dataset: &Path, names: &[PathBuf], finder: &mut Finder) {
        if self.named_depth_maps > 0 {
            self.notes.push(format!(
                "{}: the depth maps of its {} depth_file_path are not used: -d reads inverse depths, 65536 / depth in 16 bits, which is \
                 65536000 / value for maps in mm where the unit is 1 m",
                self.list.display(),
                self.named_depth_maps
            ));
            return;
        }
        let entries = std::fs::read_dir(dataset).into_iter().flatten().flatten();
        let named = |name: &str| name.to_lowercase().contains("depth");
        let mut folders: Vec<PathBuf> = entries
            .filter(|entry| named(&entry.file_name().to_string_lossy()) && entry.path().is_dir())
            .map(|entry| entry.path())
            .collect();
        folders.sort_unstable();
        for folder in folders {
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
