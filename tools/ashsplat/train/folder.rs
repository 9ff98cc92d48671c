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
use std::path::{Path, PathBuf};

const POINT_CLOUDS: &str = "point_cloud";
const RENDERS: &str = "test";
const INPUT_FILE: &str = "input.ply";
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
        keep_earlier(folder)?;
    }
    output::write_text(&folder.join(SETTINGS_FILE), &settings.to_toml()?)?;
    output::write_text(&folder.join(CFG_ARGS_FILE), &settings.to_cfg_args())?;
    let named = cameras.iter().map(|(name, camera)| (name.as_str(), camera));
    cameras_json::write(folder.join(CAMERAS_FILE), named)?;
    points.map_or(Ok(()), |points| ply::write_points(folder.join(INPUT_FILE), points))?;
    Ok(lock)
}

/// Of a run that was killed.
fn remove_leftovers(folder: &Path) {
    output::remove_leftovers(folder, 0);
    output::remove_leftovers(&folder.join(POINT_CLOUDS), 1);
    output::remove_leftovers(&folder.join(RENDERS), 2);
}

/// The files that a training leaves in its folder, beside the checkpoints.
const LEFT: [&str; 12] = [
    model::LAST_ITERATION_FILE,
    SETTINGS_FILE,
    CFG_ARGS_FILE,
    CAMERAS_FILE,
    INPUT_FILE,
    eval::RESULTS_FILE,
    eval::PER_VIEW_FILE,
    REPORT_FILE,
    LOG_FILE,
    EXPOSURE_FILE,
    LENS_FILE,
    POSES_FILE,
];

/// Moves all of an earlier training into `earlier_1`, or the next number that is free: a model folder of its own. Nothing is
/// overwritten, for a command may have been given a second time by mistake.
fn keep_earlier(folder: &Path) -> Result<()> {
    let mut left: Vec<PathBuf> = LEFT.iter().map(PathBuf::from).collect();
    left.extend(checkpoints::names(folder));
    left.retain(|name| folder.join(name).is_file());
    left.extend(folder.join(POINT_CLOUDS).is_dir().then(|| POINT_CLOUDS.into()));
    // Of `test` only what `eval` writes there: the folder may hold photographs as well.
    let of_tests = names(&folder.join(RENDERS)).into_iter().filter(|name| name.starts_with("ours_"));
    left.extend(of_tests.map(|name| Path::new(RENDERS).join(name)));
    if left.is_empty() {
        return Ok(());
    }
    let earlier = (1..).map(|n| folder.join(format!("earlier_{n}"))).find(|path| !path.exists());
    let earlier = earlier.unwrap_or_default();
    for name in &left {
        let (from, to) = (folder.join(name), earlier.join(name));
        atomic::create_folder(to.parent().unwrap_or(&earlier))?;
        std::fs::rename(&from, to).map_err(|e| Error::io(&from, "move", e))?;
    }
    let (folder, earlier) = (folder.display(), earlier.display());
    tell!(
        "warning: {folder}: had an earlier training, which is in {earlier} now; remove it if nobody needs it"
    );
    Ok(())
}

/// The names in a folder; none if it cannot be read.
fn names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).into_iter().flatten();
    entries.filter_map(|entry| entry.ok()?.file_name().into_string().ok()).collect()
}
