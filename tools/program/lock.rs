//! Locks a folder, so that only one run at a time writes into it.
//!
//! The lock is the operating system's (`flock`), which ends with the process in any case, so none is left behind.
//! Without such locks (systems other than Unix, some network file systems) nothing is locked.

use crate::session;
use ashsplat::{Error, Result};
use ashsplat_files::{atomic, regular_file};
use std::fs::{self, File};
use std::io::{ErrorKind, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::time::Duration;

/// Interval between checks of a folder that another process holds.
const WAIT: Duration = Duration::from_millis(500);
/// Number and interval of further tries before a folder counts as held.
const GLANCES: u32 = 3;
const GLANCE: Duration = Duration::from_millis(20);
/// How often a folder may vanish between its creation and its lock.
const MOST_VANISHED: u32 = 20;

/// Kind of work in a locked folder.
pub struct Work {
    /// Name of the lock file.
    pub file: &'static str,
    /// Name of the work for messages, such as "training".
    pub what: &'static str,
    /// Option that names another folder.
    pub option: &'static str,
}

/// The training that writes into a model folder.
pub const TRAINING: Work = Work { file: ".training.lock", what: "training", option: "-m" };

/// A lock on a folder, held until it is dropped.
pub struct FolderLock {
    path: PathBuf,
    /// `None` if files cannot be locked.
    held: Option<File>,
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
    pub fn take(folder: &Path, work: &Work, waits: Option<&AtomicBool>) -> Result<Self> {
        let (mut glances, mut reported) = (0, false);
        loop {
            let made = missing(folder);
            match atomic::create_folder(folder).and_then(|()| Self::try_take(folder, work)) {
                Ok(Try::Locked(mut lock)) => {
                    lock.made = made;
                    return Ok(lock);
                }
                // Another process that only checks the lock holds it for a moment.
                Ok(Try::Held(_)) if glances < GLANCES || reported => {}
                Ok(Try::Held(by)) if waits.is_some() => {
                    reported = true;
                    tell!("waiting for another {}{by} that writes into {}", work.what, folder.display());
                }
                Ok(Try::Held(by)) => {
                    let problem = format!("another {}{by} is writing into this folder", work.what);
                    let remedy = format!("wait for its end, or choose another {}", work.option);
                    return Err(Error::input(folder, problem, remedy));
                }
                // The process that created the folder has removed it meanwhile.
                Err(Error::Io { source, .. })
                    if source.kind() == ErrorKind::NotFound && glances < MOST_VANISHED => {}
                Err(error) => return Err(error),
            }
            waits.map_or(Ok(()), session::check)?;
            std::thread::sleep(if glances < GLANCES { GLANCE } else { WAIT });
            glances += 1;
        }
    }

    fn try_take(folder: &Path, work: &Work) -> Result<Try> {
        let path = folder.join(work.file);
        loop {
            let mut options = File::options();
            options.read(true).write(true).create(true).truncate(false);
            let file = options.open(&path).map_err(|e| Error::io(&path, "open", e))?;
            if let Some(tried) = Self::try_open(folder, file, work)? {
                return Ok(tried);
            }
        }
    }

    /// Locks the open file; `None` if its last holder has removed it since.
    fn try_open(folder: &Path, mut file: File, work: &Work) -> Result<Option<Try>> {
        let path = folder.join(work.file);
        match try_lock(&file) {
            Locked::Yes => {}
            Locked::Unknown => {
                let folder = folder.display();
                tell!(
                    "warning: {folder}: files cannot be locked here; see that no other {} writes into it",
                    work.what
                );
                return Ok(Some(Try::Locked(Self { path, held: None, made: Vec::new() })));
            }
            Locked::No => {
                let holder = name_in(file);
                let by = if holder.is_empty() { String::new() } else { format!(" ({holder})") };
                return Ok(Some(Try::Held(by)));
            }
        }
        if !is_at(&file, &path) {
            return Ok(None);
        }
        let written = file.set_len(0).and_then(|()| write!(file, "{}", own_name()));
        written.map_err(|e| Error::io(&path, "write", e))?;
        Ok(Some(Try::Locked(Self { path, held: Some(file), made: Vec::new() })))
    }
}

/// Result of a try.
enum Try {
    Locked(FolderLock),
    /// Held by another process: " (its name)", or empty if the name is unknown.
    Held(String),
}

/// The holder of a folder, in words; `None` if there is none or it cannot be determined.
pub fn holder(folder: &Path, work: &Work) -> Option<String> {
    let (file, _) = regular_file::open(folder.join(work.file)).ok()?;
    match try_lock(&file) {
        Locked::Yes | Locked::Unknown => None,
        Locked::No => Some(name_in(file)),
    }
}

/// Name that a holder has written; it is only used in messages.
fn name_in(file: File) -> String {
    let mut name = String::new();
    file.take(1024).read_to_string(&mut name).ok();
    name.trim().to_owned()
}

/// "process 12 on node7": several machines may share the folder.
fn own_name() -> String {
    let process = std::process::id();
    #[cfg(unix)]
    {
        let machine = rustix::system::uname();
        format!("process {process} on {}", machine.nodename().to_string_lossy())
    }
    #[cfg(not(unix))]
    format!("process {process}")
}

/// The missing folders of a path, the innermost first.
fn missing(folder: &Path) -> Vec<PathBuf> {
    let is_missing = |path: &&Path| !path.as_os_str().is_empty() && !path.exists();
    folder.ancestors().take_while(is_missing).map(Path::to_owned).collect()
}

impl Drop for FolderLock {
    fn drop(&mut self) {
        if self.held.is_some() || !self.made.is_empty() {
            fs::remove_file(&self.path).ok();
        }
        // Network file systems keep open files in their folder.
        drop(self.held.take());
        // Folders that are not empty stay.
        self.made.iter().for_each(|folder| drop(fs::remove_dir(folder)));
    }
}

#[cfg_attr(not(unix), allow(dead_code))]
enum Locked {
    Yes,
    No,
    Unknown,
}

#[cfg(unix)]
fn try_lock(file: &File) -> Locked {
    use rustix::fs::{FlockOperation, flock};
    match flock(file, FlockOperation::NonBlockingLockExclusive) {
        Ok(()) => Locked::Yes,
        Err(rustix::io::Errno::WOULDBLOCK) => Locked::No,
        Err(_) => Locked::Unknown,
    }
}

#[cfg(not(unix))]
fn try_lock(_: &File) -> Locked {
    Locked::Unknown
}

/// True if a path still names this file.
#[cfg(unix)]
fn is_at(file: &File, path: &Path) -> bool {
    use std::os::unix::fs::MetadataExt;
    let of = |metadata: fs::Metadata| (metadata.dev(), metadata.ino());
    match (file.metadata(), fs::metadata(path)) {
        (Ok(own), Ok(there)) => of(own) == of(there),
        _ => false,
    }
}

#[cfg(not(unix))]
fn is_at(_: &File, _: &Path) -> bool {
    true
}

#[cfg(test)]
#[cfg(unix)]
mod tests {
    use super::*;

    const WORK: Work = Work { file: ".training.lock", what: "training", option: "-m" };

    #[test]
    fn one_holds_a_folder_until_the_end() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let first = FolderLock::take(folder.path(), &WORK, None).expect("free");
        let refused = FolderLock::take(folder.path(), &WORK, None).err().map(|error| error.to_string());
        let refused = refused.expect("refused");
        let holder = format!("another training ({})", own_name());
        assert!(refused.contains(&holder) && refused.contains("choose another -m"), "{refused}");
        assert_eq!(super::holder(folder.path(), &WORK), Some(own_name()));
        let asked_to_end = AtomicBool::new(true);
        let ended = FolderLock::take(folder.path(), &WORK, Some(&asked_to_end)).err();
        assert!(matches!(ended, Some(Error::Interrupted)), "it waits, and ends when it is asked to");
        drop(first);
        assert_eq!(super::holder(folder.path(), &WORK), None);
        assert_eq!(fs::read_dir(folder.path()).expect("a folder").count(), 0, "nothing is left");
        // The file of a killed process has no holder.
        fs::write(folder.path().join(WORK.file), "process 1").expect("written");
        drop(FolderLock::take(folder.path(), &WORK, None).expect("free"));
        assert_eq!(fs::read_dir(folder.path()).expect("a folder").count(), 0);
    }

    /// The last holder leaves between another's opening and locking of the file, and a third process comes: the third
    /// has the lock.
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
    /// Several threads wait for a missing folder at once: each holds it once, and none is refused.
    #[test]
    fn all_who_wait_for_a_new_folder_come_to_hold_it() {
        use std::sync::atomic::{AtomicU32, Ordering};
        let place = tempfile::tempdir().expect("a temporary folder");
        let folder = place.path().join("of/one");
        let (inside, never) = (AtomicU32::new(0), AtomicBool::new(false));
        std::thread::scope(|scope| {
            for _ in 0..5 {
                scope.spawn(|| {
                    let lock = FolderLock::take(&folder, &WORK, Some(&never)).expect("held");
                    assert_eq!(inside.fetch_add(1, Ordering::SeqCst), 0, "two at once");
                    std::thread::sleep(GLANCE);
                    inside.fetch_sub(1, Ordering::SeqCst);
                    drop(lock);
                });
            }
        });
        // Folders that were created for a lock are removed with it.
        let other = place.path().join("another/one");
        drop(FolderLock::take(&other, &WORK, Some(&never)).expect("held"));
        assert!(!place.path().join("another").exists());
    }
}
