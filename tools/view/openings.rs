//! Scenes that pages send or name while the viewer runs. One opens at a time, within bounds, and only if the viewer was started
//! without a scene.

use ashsplat_files::splats::Format;
use ashsplat_program::session::locked;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use tempfile::TempDir;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

/// The machines that reach the viewer's port.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reach {
    ThisMachine,
    Others,
}

/// The scenes that pages may open.
pub struct Openings {
    /// Pages may name paths in this folder or below; none: no paths.
    folder: Option<PathBuf>,
    /// Largest file that a page may send, bytes.
    pub most_bytes: u64,
    turn: Arc<Semaphore>,
    request: Mutex<Option<OpenRequest>>,
}

/// A scene to open: of the command line, or of a page.
#[derive(Default)]
pub struct OpenRequest {
    pub path: PathBuf,
    /// Name for people.
    pub name: String,
    /// Folder in which all files that are read for it must lie.
    pub within: Option<PathBuf>,
    /// Folder of an uploaded file, removed when this is dropped.
    pub upload: Option<TempDir>,
    /// A page's exclusive right to open a scene, until it is dropped.
    pub turn: Option<OwnedSemaphorePermit>,
}

impl OpenRequest {
    /// Folder of a file that a page has sent: its path means nothing to people.
    pub fn room(&self) -> Option<String> {
        let upload = self.upload.as_ref()?;
        Some(format!("{}{}", upload.path().display(), std::path::MAIN_SEPARATOR))
    }
}

impl Openings {
    /// Paths below `folder` may be opened only if no other machine reaches the viewer. `most_bytes` is the host memory that
    /// reading may take: a larger file could not be read.
    pub fn new(folder: Option<PathBuf>, reach: Reach, most_bytes: u64) -> Openings {
        let folder = folder
            .filter(|_| reach == Reach::ThisMachine)
            .and_then(|folder| dunce::canonicalize(folder).ok());
        Openings { folder, most_bytes, turn: Arc::new(Semaphore::new(1)), request: Mutex::default() }
    }

    /// Describes the limits to a page.
    pub fn described(&self) -> Value {
        json!({ "folder": self.folder, "bytes": self.most_bytes, "formats": FORMATS.map(Format::extension) })
    }

    /// Takes the right to open a scene. None while another page has it.
    pub fn turn(&self) -> Option<OwnedSemaphorePermit> {
        self.turn.clone().try_acquire_owned().ok()
    }

    pub fn ask(&self, request: OpenRequest) {
        *locked(&self.request) = Some(request);
    }

    /// Takes the scene to open, if any.
    pub fn take(&self) -> Option<OpenRequest> {
        locked(&self.request).take()
    }

    /// Resolves a path that a page names; links may not lead out of the folder either. A path outside gets the same error as a
    /// missing one.
    pub fn find(&self, name: &str) -> Result<(PathBuf, &Path), String> {
        let Some(folder) = &self.folder else {
            return Err("this viewer opens no paths: other machines reach it, or its folder has gone".into());
        };
        let found = dunce::canonicalize(folder.join(name)).ok().filter(|path| path.starts_with(folder));
        // Opening a pipe would wait for its writer.
        let found = found.filter(|path| path.is_file() || path.is_dir());
        let missing = || format!("{name}: is not in {} or below it", folder.display());
        found.map(|path| (path, folder.as_path())).ok_or_else(missing)
    }
}

/// Formats that consist of one file.
const FORMATS: [Format; 6] =
    [Format::Ply, Format::CompressedPly, Format::Splat, Format::Spz, Format::Glb, Format::Sog];

/// The format that a file's name says, if it consists of one file.
pub fn format_of(name: &str) -> Option<Format> {
    Format::of_extension(name).ok().filter(|format| FORMATS.contains(format))
}
