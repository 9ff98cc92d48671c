//! What a run leaves in its model folder before the first iteration.

use super::poses::POSES_FILE;
use super::report::REPORT_FILE;
use super::{LOG_FILE, checkpoints};
use crate::config::{CAMERAS_FILE, CFG_ARGS_FILE, SETTINGS_FILE, Settings};
use crate::lock::{FolderLock, Work};
use crate::{eval, model, output};
use ashsplat::scene::{Camera, PointCloud};
use ashsplat::{Error, Result};
use ashsplat_files::exposure_json::EXPOSURE_FILE;
use ashsplat_files::lens_json::LENS_FILE;
use ashsplat_files::{atomic, cameras_json, ply};
use std::path::Path;

const TRAINING: Work = Work { file: ".training.lock", what: "training", option: "-m" };

/// Creates the model folder and writes what is known before training; without points, what was written before a
/// checkpoint stays.
///
/// # Errors
/// Where another training writes into the folder; a full disk and the like.
pub fn begin(
    settings: &Settings,
    cameras: &[(String, Camera)],
    points: Option<&PointCloud>,
) -> Result<FolderLock> {
    let folder = &settings.data.model_path;
    atomic::create_folder(folder)?;
    // Before anything is removed: it may be another training's.
    let lock = FolderLock::take(folder, &TRAINING)?;
    remove_leftovers(folder);
    if points.is_some() {
        clear_up_after_others(folder)?;
    }
    output::write_text(&folder.join(SETTINGS_FILE), &settings.to_toml()?)?;
    output::write_text(&folder.join(CFG_ARGS_FILE), &settings.to_cfg_args())?;
    let named = cameras.iter().map(|(name, camera)| (name.as_str(), camera));
    cameras_json::write(folder.join(CAMERAS_FILE), named)?;
    points.map_or(Ok(()), |points| ply::write_points(folder.join("input.ply"), points))?;
    Ok(lock)
}

/// Of a run that was killed.
fn remove_leftovers(folder: &Path) {
    output::remove_leftovers(folder, 0);
    output::remove_leftovers(&folder.join("point_cloud"), 1);
    output::remove_leftovers(&folder.join("test"), 2);
}

/// What a training leaves beside its point clouds.
const LEFT: [&str; 7] =
    [eval::RESULTS_FILE, eval::PER_VIEW_FILE, REPORT_FILE, LOG_FILE, EXPOSURE_FILE, LENS_FILE, POSES_FILE];

/// Moves what would be taken for this run's into `earlier_1`, or the next number that is free, and warns of the point clouds of
/// earlier ones. Nothing is removed: a command may have been given a second time by mistake.
fn clear_up_after_others(folder: &Path) -> Result<()> {
    let left: Vec<&str> = LEFT.into_iter().filter(|name| folder.join(name).exists()).collect();
    if !left.is_empty() {
        let earlier = (1..).map(|n| folder.join(format!("earlier_{n}"))).find(|path| !path.exists());
        let earlier = earlier.unwrap_or_default();
        atomic::create_folder(&earlier)?;
        for name in &left {
            let from = folder.join(name);
            std::fs::rename(&from, earlier.join(name)).map_err(|e| Error::io(&from, "move", e))?;
        }
        let folder = folder.display();
        tell!(
            "warning: {folder}: has an earlier training; its {} are now in {}",
            left.join(", "),
            earlier.display()
        );
    }
    checkpoints::forget_newest(folder)?;
    let older: Vec<String> =
        model::saved_iterations(folder).iter().map(|n| format!("iteration_{n}")).collect();
    if !older.is_empty() {
        let (folder, older) = (folder.display(), older.join(", "));
        tell!(
            "warning: {folder}: has point clouds of an earlier training ({older}); --iteration N chooses them"
        );
    }
    Ok(())
}
