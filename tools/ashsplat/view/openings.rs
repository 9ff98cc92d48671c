//! Scenes that pages bring or name while the viewer runs: one at a time, within bounds, and only where the viewer was
//! started without one.

use ashsplat_files::splats::Format;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tempfile::TempDir;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

/// Who reaches the viewer's port.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reach {
    ThisMachine,
    Others,
}

/// What pages may open.
pub struct Openings {
    /// They may name what lies here or below; none: they may name nothing.
    folder: Option<PathBuf>,
    /// Most bytes of a file that they send.
    most_bytes: u64,
    turn: Arc<Semaphore>,
    wish: Mutex<Option<Wish>>,
}

/// The right to open something: until it is dropped, nobody else has it.
pub struct Turn(#[allow(dead_code)] OwnedSemaphorePermit);

/// Something that a page wants opened.
pub struct Wish {
    pub path: PathBuf,
    /// How it is called.
    pub name: String,
    /// Where all that is read for it must lie.
    pub within: Option<PathBuf>,
    /// Its file goes with it.
    pub upload: Option<TempDir>,
    pub turn: Turn,
}

impl Openings {
    /// Paths below `folder` are for a viewer that this machine alone reaches. A file that is larger than the host memory
    /// that reading may take could not be read.
    pub fn new(folder: Option<PathBuf>, reach: Reach, most_bytes: u64) -> Openings {
        let folder =
            folder.filter(|_| reach == Reach::ThisMachine).and_then(|folder| folder.canonicalize().ok());
        Openings { folder, most_bytes, turn: Arc::new(Semaphore::new(1)), wish: Mutex::default() }
    }

    fn lock(&self) -> MutexGuard<'_, Option<Wish>> {
        // A panic of another thread leaves nothing half-done here.
        self.wish.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// What a page is told of it.
    pub fn described(&self) -> Value {
        json!({ "folder": self.folder, "bytes": self.most_bytes, "formats": FORMATS.map(Format::extension) })
    }

    pub fn most_bytes(&self) -> u64 {
        self.most_bytes
    }

    /// None while another page's is sent or read.
    pub fn turn(&self) -> Option<Turn> {
        self.turn.clone().try_acquire_owned().ok().map(Turn)
    }

    /// Asks for something to be opened.
    pub fn ask(&self, wish: Wish) {
        *self.lock() = Some(wish);
    }

    /// What is to be opened, once.
    pub fn take(&self) -> Option<Wish> {
        self.lock().take()
    }

    /// Where a path that a page names leads: also by links no farther than the folder. What lies elsewhere and what does
    /// not exist are answered alike.
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

/// Formats of a single file.
const FORMATS: [Format; 5] = [Format::Ply, Format::CompressedPly, Format::Splat, Format::Spz, Format::Glb];

/// The format that a file has by its name, if it consists of one file.
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
