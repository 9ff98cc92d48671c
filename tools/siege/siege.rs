//! Shared by all attacks: the program, a temporary folder, and the peak memory.

use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use std::error::Error;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use tempfile::TempDir;

/// An error is a text for people.
pub type Result<T> = std::result::Result<T, Box<dyn Error + Send + Sync>>;

/// Returns an error unless a condition holds.
macro_rules! ensure {
    ($holds:expr, $($text:tt)*) => {
        if !$holds {
            return Err(format!($($text)*).into());
        }
    };
}
pub(crate) use ensure;

pub struct Siege {
    pub program: PathBuf,
    pub short: bool,
    /// Peak memory of its programs, KiB.
    pub peak: Arc<AtomicU64>,
    folder: TempDir,
}

impl Siege {
    pub fn new(program: PathBuf, short: bool) -> Result<Siege> {
        // The attacker's connections need more descriptors than the usual 1024. If the limit cannot be raised, the attacks open as
        // many as they can.
        let limit = getrlimit(Resource::Nofile);
        setrlimit(Resource::Nofile, Rlimit { current: limit.maximum, ..limit }).ok();
        let folder = tempfile::Builder::new().prefix("siege").tempdir()?;
        Ok(Siege { program, short, peak: Arc::default(), folder })
    }

    /// Peak memory of the programs since it was set to 0, MiB.
    pub fn peak_mib(&self) -> u64 {
        self.peak.load(Ordering::Relaxed) >> 10
    }

    pub fn place(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub fn new_folder(&self, name: &str) -> Result<PathBuf> {
        let path = self.place(name);
        if path.exists() {
            std::fs::remove_dir_all(&path)?;
        }
        std::fs::create_dir_all(&path)?;
        Ok(path)
    }

    /// Returns the first value in a short siege, otherwise the second.
    pub fn choose<T>(&self, short: T, long: T) -> T {
        if self.short { short } else { long }
    }
}

/// A path as a command's argument.
pub fn text(path: &Path) -> Result<&str> {
    path.to_str().ok_or_else(|| "the temporary folder's name is not UTF-8".into())
}
