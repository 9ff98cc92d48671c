//! What a run leaves in its model folder before the first iteration.

use super::checkpoints;
use super::poses::POSES_FILE;
use crate::config::{CAMERAS_FILE, CFG_ARGS_FILE, SETTINGS_FILE, Settings};
use crate::lock::{FolderLock, Work};
use crate::{eval, model, output};
use ashsplat::Result;
use ashsplat::scene::{Camera, PointCloud};
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

/// Removes what would be taken for this run's, and warns of the point clouds of earlier ones: they are too dear to remove.
fn clear_up_after_others(folder: &Path) -> Result<()> {
    output::remove(&folder.join(eval::RESULTS_FILE))?;
    output::remove(&folder.join(eval::PER_VIEW_FILE))?;
    output::remove(&folder.join(EXPOSURE_FILE))?;
    output::remove(&folder.join(LENS_FILE))?;
    output::remove(&folder.join(POSES_FILE))?;
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
