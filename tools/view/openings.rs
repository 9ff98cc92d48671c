//! Scenes that pages send or name while the viewer runs. One opens at a time, within bounds, and only if the viewer was started
//! without a scene.

use ashsplat_files::splats::Format;
use ashsplat_program::session::locked;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use tempfile::TempDir;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

pub struct Openings {
    /// Pages may name paths in this folder or below; none: no paths.
    folder: Option<PathBuf>,
    /// Largest file that a page may send, bytes.
    pub max_bytes: u64,
    permit: Arc<Semaphore>,
    /// Held while paths are listed, so that only one list is made at a time.
    pub listing: Arc<Semaphore>,
    request: Mutex<Option<OpenRequest>>,
}

/// A scene to open: of the command line, or of a page.
#[derive(Default)]
pub struct OpenRequest {
    pub path: PathBuf,
    pub name: String,
    /// True if it joins the scenes that are open, instead of replacing them.
    pub add: bool,
    /// Folder in which all files that are read for it must lie.
    pub within: Option<PathBuf>,
    /// Folder of an uploaded file, removed when this is dropped.
    pub upload: Option<TempDir>,
    /// A page's exclusive right to open a scene, until it is dropped.
    pub permit: Option<OwnedSemaphorePermit>,
}

impl OpenRequest {
    /// Folder of a file that a page has sent or named. Messages to pages show paths without it.
    pub fn prefix(&self) -> Option<String> {
        let folder = self.upload.as_ref().map(TempDir::path).or(self.within.as_deref())?;
        Some(format!("{}{}", folder.display(), std::path::MAIN_SEPARATOR))
    }
}

impl Openings {
    /// Pages may name paths in `folder` or below. `max_bytes` is the host memory that reading may take: a larger file could not be read.
    pub fn new(folder: Option<PathBuf>, max_bytes: u64) -> Openings {
        let folder = folder.and_then(|folder| dunce::canonicalize(folder).ok());
        let [permit, listing] = [1, 1].map(|permits| Arc::new(Semaphore::new(permits)));
        Openings { folder, max_bytes, permit, listing, request: Mutex::default() }
    }

    pub fn described(&self) -> Value {
        json!({ "folder": self.folder.as_deref().map(name_of), "bytes": self.max_bytes, "formats": single_files(&Format::ALL) })
    }

    /// Takes the right to open a scene. None while another page has it.
    pub fn permit(&self) -> Option<OwnedSemaphorePermit> {
        self.permit.clone().try_acquire_owned().ok()
    }

    pub fn submit(&self, request: OpenRequest) {
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
        let missing = || format!("{name}: is not in {} or below it", name_of(folder));
        found.map(|path| (path, folder.as_path())).ok_or_else(missing)
    }

    /// Lists the paths that start with `begin`: folders with a `/` at the end, and files of formats with one file per scene.
    /// They are sorted and at most [`MAX_LISTED`]; `more` is true if there may be others.
    pub fn list(&self, begin: &str) -> Value {
        let (prefix, name) = begin.split_at(begin.rfind('/').map_or(0, |slash| slash + 1));
        let Ok((folder, _)) = self.find(prefix) else { return json!({ "paths": [], "more": false }) };
        let mut read = 0;
        let entries = std::fs::read_dir(folder).into_iter().flatten().flatten().take(MAX_READ);
        let path = |entry: std::fs::DirEntry| {
            read += 1;
            let own = entry.file_name().into_string().ok()?;
            let path = format!("{prefix}{own}");
            let other = format_of(&own).is_none() && entry.file_type().is_ok_and(|kind| kind.is_file());
            let is_shown = own.starts_with(name) && !own.starts_with('.') && !other;
            let (found, _) = is_shown.then(|| self.find(&path).ok()).flatten()?;
            match found.is_dir() {
                true => Some(path + "/"),
                false => format_of(&own).map(|_| path),
            }
        };
        let mut paths: Vec<String> = entries.filter_map(path).collect();
        paths.sort_unstable();
        let more = read == MAX_READ || paths.len() > MAX_LISTED;
        paths.truncate(MAX_LISTED);
        json!({ "paths": paths, "more": more })
    }
}

/// A folder's name: pages need not know where it lies.
fn name_of(folder: &Path) -> String {
    folder.file_name().unwrap_or(folder.as_os_str()).to_string_lossy().into_owned()
}

/// Most paths that are listed for a page.
const MAX_LISTED: usize = 200;
/// Most entries of a folder that are looked at for a list.
const MAX_READ: usize = 10_000;

fn is_single_file(format: &Format) -> bool {
    *format != Format::Gltf
}

/// Extensions of those formats whose scenes are single files.
pub fn single_files(formats: &[Format]) -> Vec<&'static str> {
    formats.iter().filter(|format| is_single_file(format)).map(|format| format.extension()).collect()
}

/// The format of a file by its name, if a scene in this format is one file.
pub fn format_of(name: &str) -> Option<Format> {
    Format::of_extension(name).ok().filter(is_single_file)
}
