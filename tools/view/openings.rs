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
    most_bytes: u64,
    turn: Arc<Semaphore>,
    wish: Mutex<Option<Wish>>,
}

/// The exclusive right to open a scene, until it is dropped.
pub struct Turn(#[allow(dead_code)] OwnedSemaphorePermit);

/// A scene that a page wants opened.
pub struct Wish {
    pub path: PathBuf,
    /// Name for people.
    pub name: String,
    /// Folder in which all files that are read for it must lie.
    pub within: Option<PathBuf>,
    /// Folder of an uploaded file, removed when this is dropped.
    pub upload: Option<TempDir>,
    pub turn: Turn,
}

impl Openings {
    /// Paths below `folder` may be opened only if no other machine reaches the viewer. `most_bytes` is the host memory that
    /// reading may take: a larger file could not be read.
    pub fn new(folder: Option<PathBuf>, reach: Reach, most_bytes: u64) -> Openings {
        let folder =
            folder.filter(|_| reach == Reach::ThisMachine).and_then(|folder| folder.canonicalize().ok());
        Openings { folder, most_bytes, turn: Arc::new(Semaphore::new(1)), wish: Mutex::default() }
    }

    /// Describes the limits to a page.
    pub fn described(&self) -> Value {
        json!({ "folder": self.folder, "bytes": self.most_bytes, "formats": FORMATS.map(Format::extension) })
    }

    pub fn most_bytes(&self) -> u64 {
        self.most_bytes
    }

    /// Takes the right to open a scene. None while another page has it.
    pub fn turn(&self) -> Option<Turn> {
        self.turn.clone().try_acquire_owned().ok().map(Turn)
    }

    pub fn ask(&self, wish: Wish) {
        *locked(&self.wish) = Some(wish);
    }

    /// Takes the scene to open, if any.
    pub fn take(&self) -> Option<Wish> {
        locked(&self.wish).take()
    }

    /// Resolves a path that a page names; links may not lead out of the folder either. A path outside gets the same error as a
    /// missing one.
    pub fn find(&self, name: &str) -> Result<(PathBuf, &Path), String> {
        let Some(folder) = &self.folder else {
            return Err("this viewer opens no paths: other machines reach it, or its folder has gone".into());
        };
        let found = folder.join(name).canonicalize().ok().filter(|path| path.starts_with(folder));
        // Opening a pipe would wait for its writer.
        let found = found.filter(|path| path.is_file() || path.is_dir());
        let missing = || format!("{name}: is not in {} or below it", folder.display());
        found.map(|path| (path, folder.as_path())).ok_or_else(missing)
    }
}

/// Formats that consist of one file.
const FORMATS: [Format; 5] = [Format::Ply, Format::CompressedPly, Format::Splat, Format::Spz, Format::Glb];

/// The format that a file's name says, if it consists of one file.
pub fn format_of(name: &str) -> Option<Format> {
    Format::of_extension(name).ok().filter(|format| FORMATS.contains(format))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_lead_no_farther_than_the_folder() {
        let outer = tempfile::tempdir().expect("a temporary folder");
        let folder = outer.path().join("started");
        std::fs::create_dir_all(folder.join("below")).expect("created");
        for name in ["started/a.ply", "started/below/b.ply", "secret.ply", "started_too.ply"] {
            std::fs::write(outer.path().join(name), "ply").expect("written");
        }
        let openings = Openings::new(Some(folder.clone()), Reach::ThisMachine, 1);
        let found = |name: &str| openings.find(name).map(|(path, _)| path);
        for good in ["a.ply", "below/b.ply", "below/../a.ply", ".", ""] {
            assert!(found(good).is_ok(), "{good}");
        }
        let absolute = folder.canonicalize().expect("a folder").join("a.ply");
        assert_eq!(found(absolute.to_str().expect("UTF-8")), Ok(absolute.clone()));
        #[cfg(unix)]
        std::os::unix::fs::symlink("../secret.ply", folder.join("link.ply")).expect("a link");
        for bad in [
            "../secret.ply",
            "../started_too.ply",
            "link.ply",
            "/etc/passwd",
            "../nothing.ply",
            "nothing.ply",
        ] {
            let problem = found(bad).expect_err(bad);
            assert!(problem.starts_with(&format!("{bad}: is not in ")), "{problem}");
        }
        let others = Openings::new(Some(folder), Reach::Others, 1);
        assert!(others.find("a.ply").is_err() && others.described()["folder"].is_null());
    }

    #[test]
    fn one_at_a_time() {
        let openings = Openings::new(None, Reach::ThisMachine, 1);
        let turn = openings.turn().expect("free");
        assert!(openings.turn().is_none());
        let wish = Wish { path: "a.ply".into(), name: "a.ply".into(), within: None, upload: None, turn };
        openings.ask(wish);
        let wish = openings.take().expect("asked for");
        assert!(openings.take().is_none() && openings.turn().is_none());
        drop(wish);
        assert!(openings.turn().is_some());
        assert_eq!(
            (format_of("a.PLY"), format_of("a.gltf"), format_of("a.zip")),
            (Some(Format::Ply), None, None)
        );
    }
}
