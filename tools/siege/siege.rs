//! What all attacks share: the program, a folder that goes with the siege, the most memory that was seen.

use std::error::Error;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use tempfile::TempDir;

/// What went wrong, in words.
pub type Result<T> = std::result::Result<T, Box<dyn Error + Send + Sync>>;

/// How an attack ended that did no harm.
pub enum Outcome {
    /// In words.
    Withstood(String),
    /// It cannot be made here; why.
    Skipped(String),
}

/// An error unless something holds.
macro_rules! ensure {
    ($holds:expr, $($text:tt)*) => {
        if !$holds {
            return Err(format!($($text)*).into());
        }
    };
}
pub(crate) use ensure;

/// The most memory that a program had, kibibytes.
#[derive(Clone, Default)]
pub struct Peak(Arc<AtomicU64>);

impl Peak {
    /// Begins again.
    pub fn reset(&self) {
        self.0.store(0, Ordering::Relaxed);
    }

    /// A program had so much.
    pub fn note(&self, kib: u64) {
        self.0.fetch_max(kib, Ordering::Relaxed);
    }

    pub fn mib(&self) -> u64 {
        self.0.load(Ordering::Relaxed) >> 10
    }
}

/// See the module.
pub struct Siege {
    pub program: PathBuf,
    /// Whether it is to be over soon.
    pub short: bool,
    pub peak: Peak,
    folder: TempDir,
}

impl Siege {
    pub fn new(program: PathBuf, short: bool) -> Result<Siege> {
        raise_own_descriptors();
        let folder = tempfile::Builder::new().prefix("siege").tempdir()?;
        Ok(Siege { program, short, peak: Peak::default(), folder })
    }

    /// A place in the siege's folder.
    pub fn place(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// A new empty folder in it.
    pub fn new_folder(&self, name: &str) -> Result<PathBuf> {
        let path = self.place(name);
        if path.exists() {
            std::fs::remove_dir_all(&path)?;
        }
        std::fs::create_dir_all(&path)?;
        Ok(path)
    }

    /// The first in a short siege, the second in a long one.
    pub fn choose<T>(&self, short: T, long: T) -> T {
        if self.short { short } else { long }
    }
}

/// The attacker's own connections need more than the usual 1024.
fn raise_own_descriptors() {
    use rustix::process::{Resource, getrlimit, setrlimit};
    let mut limit = getrlimit(Resource::Nofile);
    limit.current = limit.maximum;
    // Where it cannot be raised, the attacks open as many as they may.
    setrlimit(Resource::Nofile, limit).ok();
}

/// A path as an argument.
pub fn text(path: &Path) -> Result<&str> {
    path.to_str().ok_or_else(|| "the temporary folder's name is not UTF-8".into())
}
