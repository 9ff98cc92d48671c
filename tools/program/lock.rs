//! Locks a folder, so that only one run at a time writes into it.
//!
//! The lock is the operating system's, which ends with the process in any case, so none is left behind. On Windows
//! other processes cannot read a locked file. A second file therefore has the holder's name. Some network file systems
//! cannot lock files; the folder is not locked there, and a warning says so.

use crate::{output, session};
use ashsplat::{Error, Result};
use ashsplat_files::{atomic, regular_file};
use same_file::Handle;
use std::fs::{self, File, TryLockError};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::time::Duration;

/// Interval between checks of a folder that another process holds.
const POLL_INTERVAL: Duration = Duration::from_millis(500);
/// Number and interval of further tries before a folder counts as held.
const RETRIES: u32 = 3;
const RETRY_INTERVAL: Duration = Duration::from_millis(20);
/// How often a folder or a lock file may vanish between its creation and its lock.
const MAX_VANISHED: u32 = 20;

pub struct LockKind {
    pub file: &'static str,
    /// Name of the work for messages, such as "training".
    pub what: &'static str,
    /// Option that names another folder.
    pub option: &'static str,
}

/// The training that writes into a model folder.
pub const TRAINING: LockKind = LockKind { file: ".training.lock", what: "training", option: "-m" };

/// A lock on a folder, held until it is dropped.
pub struct FolderLock {
    path: PathBuf,
    /// `None` if files cannot be locked.
    held: Option<Handle>,
    /// Folders that were created for the lock, the innermost first.
    made: Vec<PathBuf>,
}

impl FolderLock {
    /// Locks a folder, which is created if needed. Dropping the lock removes new folders that are still empty. With
    /// `waits`, waits while another process holds the folder, and reports which; several processes may create it at once.
    ///
    /// # Errors
    /// [`Error::Input`] naming the process that holds it, unless it `waits`; [`Error::Interrupted`] if `waits` is set
    /// meanwhile; [`Error::Io`].
    pub fn take(folder: &Path, kind: &LockKind, waits: Option<&AtomicBool>) -> Result<Self> {
        let (mut retries, mut reported) = (0, false);
        loop {
            let made = missing(folder);
            match atomic::create_folder(folder).and_then(|()| Self::try_take(folder, kind)) {
                Ok(Attempt::Locked(mut lock)) => {
                    lock.made = made;
                    return Ok(lock);
                }
                // Another process that only checks the lock holds it for a moment.
                Ok(Attempt::Held(_)) if retries < RETRIES || reported => {}
                Ok(Attempt::Held(holder)) if waits.is_some() => {
                    reported = true;
                    errln!("waiting for another {}{holder} that writes into {}", kind.what, folder.display());
                }
                Ok(Attempt::Held(holder)) => {
                    let problem = format!("another {}{holder} is writing into this folder", kind.what);
                    let remedy = format!("wait for its end, or choose another {}", kind.option);
                    return Err(Error::input(folder, problem, remedy));
                }
                // The process that created the folder or the file has removed it meanwhile.
                Err(Error::Io { source, .. }) if vanished(&source) && retries < MAX_VANISHED => {}
                Err(error) => return Err(error),
            }
            waits.map_or(Ok(()), session::check)?;
            std::thread::sleep(if retries < RETRIES { RETRY_INTERVAL } else { POLL_INTERVAL });
            retries += 1;
        }
    }

    fn try_take(folder: &Path, kind: &LockKind) -> Result<Attempt> {
        let path = folder.join(kind.file);
        loop {
            let mut options = File::options();
            // The lint names methods that may wait at a pipe; opening one for reading and writing does not.
            #[allow(clippy::disallowed_methods)]
            options.read(true).write(true).create(true).truncate(false);
            let file = options.open(&path).map_err(|e| Error::io(&path, "open", e))?;
            if let Some(attempt) = Self::try_open(folder, file, kind)? {
                return Ok(attempt);
            }
        }
    }

    /// Locks the open file; `None` if its last holder has removed it since.
    fn try_open(folder: &Path, file: File, kind: &LockKind) -> Result<Option<Attempt>> {
        let path = folder.join(kind.file);
        let file = Handle::from_file(file).map_err(|e| Error::io(&path, "open", e))?;
        let held = match file.as_file().try_lock() {
            Ok(()) if Handle::from_path(&path).is_ok_and(|current| current == file) => Some(file),
            Ok(()) => return Ok(None),
            Err(TryLockError::WouldBlock) => {
                let holder = name_in(&path).map_or_else(String::new, |holder| format!(" ({holder})"));
                return Ok(Some(Attempt::Held(holder)));
            }
            Err(TryLockError::Error(_)) => {
                let (folder, what) = (folder.display(), kind.what);
                errln!(
                    "warning: {folder}: files cannot be locked here; see that no other {what} writes into it"
                );
                None
            }
        };
        if held.is_some() {
            // Several machines may share the folder.
            let host = gethostname::gethostname();
            let own_name = format!("process {} on {}", std::process::id(), host.to_string_lossy());
            fs::write(name_file(&path), own_name).map_err(|e| Error::io(&path, "write", e))?;
        }
        Ok(Some(Attempt::Locked(Self { path, held, made: Vec::new() })))
    }
}

enum Attempt {
    Locked(FolderLock),
    /// Held by another process: " (its name)", or empty if the name is unknown.
    Held(String),
}

/// The holder of a folder, in words; `None` if there is none or it cannot be determined.
pub fn holder(folder: &Path, kind: &LockKind) -> Option<String> {
    let path = folder.join(kind.file);
    let (file, _) = regular_file::open(&path).ok()?;
    matches!(file.try_lock(), Err(TryLockError::WouldBlock)).then(|| name_in(&path).unwrap_or_default())
}

/// File with the name of the process that holds a lock file: `.training.holder`.
fn name_file(lock: &Path) -> PathBuf {
    lock.with_extension("holder")
}

/// Name that a holder has written; it is only used in messages.
fn name_in(lock: &Path) -> Option<String> {
    output::read_note(&name_file(lock)).map(|name| name.trim().to_owned()).filter(|name| !name.is_empty())
}

/// True if a file or its folder is gone. Windows refuses access to a removed file that another process still has open.
fn vanished(error: &std::io::Error) -> bool {
    error.kind() == ErrorKind::NotFound || cfg!(windows) && error.kind() == ErrorKind::PermissionDenied
}

/// The missing folders of a path, the innermost first.
fn missing(folder: &Path) -> Vec<PathBuf> {
    let is_missing = |path: &&Path| !path.as_os_str().is_empty() && !path.exists();
    folder.ancestors().take_while(is_missing).map(Path::to_owned).collect()
}

impl Drop for FolderLock {
    fn drop(&mut self) {
        if self.held.is_some() || !self.made.is_empty() {
            fs::remove_file(name_file(&self.path)).ok();
            fs::remove_file(&self.path).ok();
        }
        // Network file systems keep open files in their folder.
        drop(self.held.take());
        // Folders that are not empty stay.
        self.made.iter().for_each(|folder| drop(fs::remove_dir(folder)));
    }
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;

    const WORK: LockKind = LockKind { file: ".training.lock", what: "training", option: "-m" };

    /// The last holder leaves between another's opening and locking of the file, and a third process comes: the third
    /// has the lock. On Windows a removed file stays until all have closed it, and no other is made in its place.
    #[test]
    fn a_file_that_is_gone_locks_nothing() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let first = FolderLock::take(folder.path(), &WORK, None).expect("free");
        let open = || File::options().read(true).write(true).open(folder.path().join(WORK.file));
        let [early, late] = [open(), open()].map(|file| file.expect("it is there"));
        drop(first);
        assert!(FolderLock::try_open(folder.path(), early, &WORK).expect("no holder").is_none());
        let third = FolderLock::take(folder.path(), &WORK, None).expect("free");
        assert!(FolderLock::try_open(folder.path(), late, &WORK).expect("no holder").is_none());
        assert!(FolderLock::take(folder.path(), &WORK, None).is_err());
        drop(third);
    }
}
