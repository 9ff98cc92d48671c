//! Prepares the model folder before the first iteration.

use super::checkpoints;
use super::poses::{POSES_FILE, REFINED_FOLDER};
use super::report::REPORT_FILE;
use ashsplat::scene::{Camera, PointCloud, WorldFrame};
use ashsplat::{Error, Result};
use ashsplat_files::exposure_json::EXPOSURE_FILE;
use ashsplat_files::lens_json::LENS_FILE;
use ashsplat_files::{atomic, cameras_json, ply};
use ashsplat_program::blocks::result::RESULT_FILE;
use ashsplat_program::blocks::rounds::ROUND_FILE;
use ashsplat_program::config::{CAMERAS_FILE, CFG_ARGS_FILE, SETTINGS_FILE, Settings};
use ashsplat_program::lock::{FolderLock, TRAINING};
use ashsplat_program::train_log::LOG_FILE;
use ashsplat_program::{eval, model, output};
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

const RENDERS: &str = "test";
/// Films from the viewer.
const FILMS: &str = "films";
const INPUT_FILE: &str = "input.ply";

/// Locks an existing model folder before its checkpoints are looked up: another training would still write them. With
/// `wait`, the call waits for the end of that training, and the folder need not exist yet.
///
/// # Errors
/// [`Error::Input`] if another training writes into the folder.
pub fn hold(folder: &Path, wait: bool, stop: &AtomicBool) -> Result<Option<FolderLock>> {
    if !wait && !folder.is_dir() {
        return Ok(None);
    }
    FolderLock::take(folder, &TRAINING, wait.then_some(stop)).map(Some)
}

/// Creates and locks the model folder if that is still to be done, and writes everything known before training. A run
/// that continues in this folder keeps its files.
///
/// # Errors
/// [`Error::Input`] if another training writes into the folder; [`Error::Io`], such as for a full disk.
pub fn begin(
    settings: &Settings,
    held: Option<FolderLock>,
    (cameras, frame): (&[(String, Camera)], &WorldFrame),
    points: Option<&PointCloud>,
    continues: bool,
) -> Result<FolderLock> {
    let folder = &settings.data.model_path;
    atomic::create_folder(folder)?;
    // Locked before anything is removed, which may be another training's.
    let lock = held.map_or_else(|| FolderLock::take(folder, &TRAINING, None), Ok)?;
    remove_leftovers(folder);
    if !continues {
        keep_earlier(folder)?;
    }
    output::write_text(&folder.join(SETTINGS_FILE), &settings.to_toml()?)?;
    output::write_text(&folder.join(CFG_ARGS_FILE), &settings.to_cfg_args())?;
    let named = cameras.iter().map(|(name, camera)| (name.as_str(), camera));
    cameras_json::write(folder.join(CAMERAS_FILE), named, frame)?;
    points.map_or(Ok(()), |points| ply::write_points(folder.join(INPUT_FILE), points, frame))?;
    Ok(lock)
}

/// Removes temporary files of a run that was killed.
fn remove_leftovers(folder: &Path) {
    output::remove_leftovers(folder, 0);
    output::remove_leftovers(&folder.join(model::POINT_CLOUDS), 1);
    output::remove_leftovers(&folder.join(RENDERS), 2);
}

/// The files that a training leaves in its folder, besides checkpoints.
const LEFT: [&str; 14] = [
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
    RESULT_FILE,
    ROUND_FILE,
];

/// Files that show an earlier training, because no data set has them.
const SIGNS: [&str; 4] = [CFG_ARGS_FILE, SETTINGS_FILE, LOG_FILE, model::LAST_ITERATION_FILE];
/// Folder of the move in progress, so that the next run completes it if this one is killed.
const UNFINISHED: &str = ".earlier_unfinished";

/// Moves an earlier training into `earlier_1`, or the next free number, as a model folder of its own. Nothing is
/// overwritten, because a command may have been repeated by mistake. Files that cannot be moved, such as links to other
/// disks, stay.
fn keep_earlier(folder: &Path) -> Result<()> {
    let unfinished = folder.join(UNFINISHED);
    if !unfinished.is_dir() && !SIGNS.iter().any(|name| folder.join(name).is_file()) {
        return Ok(());
    }
    let mut left: Vec<PathBuf> = LEFT.iter().map(PathBuf::from).collect();
    left.extend(checkpoints::names(folder));
    left.retain(|name| folder.join(name).is_file());
    left.extend(
        [model::POINT_CLOUDS, FILMS, REFINED_FOLDER]
            .map(PathBuf::from)
            .into_iter()
            .filter(|name| is_folder(&folder.join(name))),
    );
    // Only the pictures of `eval` in `test`: the folder may hold photographs too.
    let of_tests = output::names(&folder.join(RENDERS)).into_iter().filter(|name| name.starts_with("ours_"));
    left.extend(of_tests.map(|name| Path::new(RENDERS).join(name)));
    atomic::create_folder(&unfinished)?;
    for name in &left {
        let (from, to) = (folder.join(name), unfinished.join(name));
        let moved = std::fs::create_dir_all(to.parent().unwrap_or(&unfinished));
        if let Err(error) = moved.and_then(|()| std::fs::rename(&from, &to)) {
            errln!("warning: {}: is of an earlier training and cannot be moved: {error}", from.display());
        }
    }
    let earlier = (1..).map(|n| folder.join(format!("earlier_{n}"))).find(|path| !path.exists());
    let earlier = earlier.unwrap_or_default();
    std::fs::rename(&unfinished, &earlier).map_err(|e| Error::io(&unfinished, "move", e))?;
    let (folder, earlier) = (folder.display(), earlier.display());
    errln!(
        "warning: {folder}: had an earlier training, which is in {earlier} now; remove it if nobody needs it"
    );
    Ok(())
}

/// True for a folder. A link to one is not moved, because a relative target would no longer be found.
fn is_folder(path: &Path) -> bool {
    path.symlink_metadata().is_ok_and(|found| found.is_dir())
}
