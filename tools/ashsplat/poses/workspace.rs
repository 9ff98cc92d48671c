//! The unfinished work of `poses`: a folder within the data set's folder, with which a second run continues.

use ashsplat::{Error, Result};
use ashsplat_files::colmap::UNFINISHED_POSES as FOLDER;
use ashsplat_files::{atomic, colmap, regular_file};
use ashsplat_program::lock::{FolderLock, LockKind};
use ashsplat_program::output;
use serde::{Deserialize, Serialize};
use std::fs;
use std::path::{Path, PathBuf};

const STATE_FILE: &str = "state.json";
/// Folder of a finished data set that only has to be moved to its place.
const READY: &str = "ready";
/// Log of COLMAP's commands and output; it is moved beside the data set at the end.
pub use ashsplat_files::colmap::POSES_LOG as LOG_FILE;

const POSES: LockKind = LockKind { file: ".poses.lock", what: "`ashsplat poses`", option: "-o" };

/// Finished stages with keys of their inputs. A stage with the same inputs is not repeated.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
struct State {
    frames: Option<String>,
    /// Key of the features in COLMAP's database.
    features: Option<String>,
}

pub struct Workspace {
    dataset: PathBuf,
    pub folder: PathBuf,
    state: State,
    /// Folders that were created for the work, the innermost first.
    new: Vec<PathBuf>,
    _lock: FolderLock,
}

impl Workspace {
    /// Refuses a data set's folder that already has files to be written. `linked` includes its folder `images`.
    pub fn check(dataset: &Path, linked: bool) -> Result<()> {
        output::check_folder(dataset).map_err(|e| {
            Error::input(dataset, format!("cannot be written: {e}"), "name another folder with -o")
        })?;
        if colmap::exists(dataset) || has_entries(&dataset.join("sparse")) {
            let all = if linked { dataset.to_owned() } else { dataset.join("sparse") };
            let remedy = format!(
                "train on it; or remove {} to find the cameras anew, or choose another -o",
                all.display()
            );
            return Err(Error::input(dataset.join("sparse"), "is there already", remedy));
        }
        let state = State::read(&dataset.join(FOLDER));
        if dataset.join(FOLDER).is_dir() && state.is_none() && has_entries(&dataset.join(FOLDER)) {
            let remedy = "remove it, or choose another -o";
            return Err(Error::input(dataset.join(FOLDER), "is not from `ashsplat poses`", remedy));
        }
        if linked && has_entries(&dataset.join("images")) {
            let remedy = "rename it, or choose another -o";
            return Err(Error::input(dataset.join("images"), "is there already, with photographs", remedy));
        }
        // At the end, folders are renamed to these names, and a file to the log's.
        for name in if linked { &["sparse", "images"][..] } else { &["sparse"] } {
            let place = dataset.join(name);
            if place.is_symlink() || place.is_file() {
                let remedy = "remove it, or choose another -o";
                return Err(Error::input(place, "is a link or a file, and has to become a folder", remedy));
            }
        }
        if dataset.join(LOG_FILE).is_dir() {
            let remedy = "rename it, or choose another -o";
            return Err(Error::input(
                dataset.join(LOG_FILE),
                "is a folder, and has to become a file",
                remedy,
            ));
        }
        Ok(())
    }

    /// Creates the folder of the work, or continues with it.
    pub fn open(dataset: &Path) -> Result<Self> {
        let folder = dataset.join(FOLDER);
        let new = folder.ancestors().filter(|path| !path.as_os_str().is_empty() && !path.exists());
        let new = new.map(Path::to_owned).collect();
        atomic::create_folder(&folder)?;
        let lock = FolderLock::take(&folder, &POSES, None)?;
        let state = State::read(&folder);
        let workspace =
            Self { dataset: dataset.to_owned(), state: state.unwrap_or_default(), folder, new, _lock: lock };
        workspace.save()?;
        Ok(workspace)
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    /// True if a second run can continue with a result.
    pub fn is_worth_keeping(&self) -> bool {
        self.state.frames.is_some() || self.state.features.is_some()
    }

    pub fn has_frames(&self, key: &str) -> bool {
        self.state.frames.as_deref() == Some(key) && self.path("frames").is_dir()
    }

    /// Notes the frames' key; `None` if they are incomplete.
    pub fn note_frames(&mut self, key: Option<String>) -> Result<()> {
        self.state.frames = key;
        self.save()
    }

    /// True if the database has the features of these photographs.
    pub fn has_features(&self, key: &str) -> bool {
        self.state.features.as_deref() == Some(key)
    }

    /// Notes the features' key; `None` if they are incomplete.
    pub fn note_features(&mut self, key: Option<String>) -> Result<()> {
        self.state.features = key;
        self.save()
    }

    fn save(&self) -> Result<()> {
        output::write_json(&self.path(STATE_FILE), &self.state)
    }

    /// Removes a file or folder of the work, if it exists.
    pub fn remove(&self, name: &str) -> Result<()> {
        remove(&self.path(name))
    }

    pub fn fresh_folder(&self, name: &str) -> Result<PathBuf> {
        self.remove(name)?;
        atomic::create_folder(self.path(name))?;
        Ok(self.path(name))
    }

    /// Moves photographs and model to the data set. `images`: a folder of this work.
    pub fn finish(self, model: &Path, images: Option<&Path>) -> Result<()> {
        // project.ini names files that will be removed.
        remove(&model.join("project.ini"))?;
        let ready = self.fresh_folder("readying")?;
        atomic::create_folder(ready.join("sparse"))?;
        rename(model, &ready.join("sparse/0"))?;
        images.map_or(Ok(()), |images| rename(images, &ready.join("images")))?;
        rename(&self.path(LOG_FILE), &ready.join(LOG_FILE))?;
        self.remove(READY)?;
        rename(&ready, &self.path(READY))?;
        self.place()
    }

    /// The work of a run that was killed while it moved a finished data set.
    pub fn ready(dataset: &Path) -> Result<Option<Self>> {
        let folder = dataset.join(FOLDER);
        let is_ready = folder.join(READY).is_dir() && State::read(&folder).is_some();
        is_ready.then(|| Self::open(dataset)).transpose()
    }

    /// Moves the finished files to the data set, the model last: without a model, nothing looks like a data set.
    pub fn place(mut self) -> Result<()> {
        for name in ["images", LOG_FILE, "sparse"] {
            let (from, to) = (self.path(READY).join(name), self.dataset.join(name));
            if !from.exists() {
                continue;
            }
            if to.is_dir() {
                // The folder was empty when the run began.
                fs::remove_dir(&to).map_err(|e| Error::io(&to, "replace", e))?;
            }
            rename(&from, &to)?;
        }
        self.new.clear();
        remove(&self.folder)
    }

    pub fn abandon(self) {
        remove(&self.folder).ok();
        // A folder with a file of another program stays.
        self.new.iter().skip(1).all(|folder| fs::remove_dir(folder).is_ok());
    }
}

impl State {
    fn read(folder: &Path) -> Option<Self> {
        serde_json::from_slice(&regular_file::read_json(folder.join(STATE_FILE)).ok()?).ok()
    }
}

fn rename(from: &Path, to: &Path) -> Result<()> {
    fs::rename(from, to).map_err(|e| Error::io(to, "create", e))
}

fn has_entries(folder: &Path) -> bool {
    fs::read_dir(folder).is_ok_and(|mut entries| entries.next().is_some())
}

fn remove(path: &Path) -> Result<()> {
    let result = match path.is_dir() && !path.is_symlink() {
        true => fs::remove_dir_all(path),
        false => fs::remove_file(path),
    };
    match result {
        Err(e) if e.kind() != std::io::ErrorKind::NotFound => Err(Error::io(path, "remove", e)),
        _ => Ok(()),
    }
}

/// Links photographs to another folder, or copies them if the file system cannot link. Returns the
/// number of copies.
pub fn link_photos(from: &Path, names: &[String], to: &Path) -> Result<usize> {
    let mut copies = 0;
    for name in names {
        let (source, target) = (from.join(name), to.join(name));
        if let Some(folder) = target.parent() {
            atomic::create_folder(folder)?;
        }
        // A link to a symbolic link would depend on its target.
        let source = source.canonicalize().map_err(|e| Error::io(&source, "read", e))?;
        if fs::hard_link(&source, &target).is_err() {
            let (mut photo, _) = regular_file::open(&source)?;
            atomic::write(&target, |out| std::io::copy(&mut photo, out).map(drop))?;
            copies += 1;
        }
    }
    Ok(copies)
}
