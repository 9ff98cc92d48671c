//! One run at a time writes into a folder.
//!
//! The lock is the operating system's (`flock`): it ends with the process, however that ends, so none is left behind.
//! Where there is no such lock (other systems than Unix, some network file systems) nothing is locked.

use ashsplat::{Error, Result};
use std::fs::{self, File};
use std::io::{Read, Write};
use std::path::{Path, PathBuf};

/// What is done in a locked folder.
pub struct Work {
    /// The lock's name.
    pub file: &'static str,
    /// "training"
    pub what: &'static str,
    /// The option that names another folder.
    pub option: &'static str,
}

/// Holds a folder until it is dropped.
pub struct FolderLock {
    path: PathBuf,
    /// None where files cannot be locked.
    held: Option<File>,
}

impl FolderLock {
    /// Locks a folder, which exists.
    ///
    /// # Errors
    /// [`Error::Input`] naming the process that holds it; [`Error::Io`].
    pub fn take(folder: &Path, work: &Work) -> Result<Self> {
        let path = folder.join(work.file);
        loop {
            let file = File::options()
                .read(true)
                .write(true)
                .create(true)
                .truncate(false)
                .open(&path)
                .map_err(|e| Error::io(&path, "open", e))?;
            if let Some(lock) = Self::take_open(folder, file, work)? {
                return Ok(lock);
            }
        }
    }

    /// Locks the open file; none where its last holder has removed it since it was opened.
    fn take_open(folder: &Path, mut file: File, work: &Work) -> Result<Option<Self>> {
        let path = folder.join(work.file);
        match try_lock(&file) {
            Locked::Yes => {}
            Locked::Unknown => {
                let folder = folder.display();
                tell!(
                    "warning: {folder}: files cannot be locked here; see that no other {} writes into it",
                    work.what
                );
                return Ok(Some(Self { path, held: None }));
            }
            Locked::No => {
                let mut holder = String::new();
                // Its name only makes the message better.
                file.read_to_string(&mut holder).ok();
                let holder = holder.trim();
                let by = if holder.is_empty() { String::new() } else { format!(" ({holder})") };
                let problem = format!("another {}{by} is writing into this folder", work.what);
                let remedy = format!("wait for its end, or choose another {}", work.option);
                return Err(Error::input(folder, problem, remedy));
            }
        }
        if !is_at(&file, &path) {
            return Ok(None);
        }
        let written = file.set_len(0).and_then(|()| write!(file, "process {}", std::process::id()));
        written.map_err(|e| Error::io(&path, "write", e))?;
        Ok(Some(Self { path, held: Some(file) }))
    }
}

impl Drop for FolderLock {
    fn drop(&mut self) {
        if self.held.is_some() {
            fs::remove_file(&self.path).ok();
        }
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

/// Whether a path still names this file.
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
        let first = FolderLock::take(folder.path(), &WORK).expect("free");
        let refused = FolderLock::take(folder.path(), &WORK).err().map(|error| error.to_string());
        let refused = refused.expect("refused");
        let holder = format!("another training (process {})", std::process::id());
        assert!(refused.contains(&holder) && refused.contains("choose another -m"), "{refused}");
        drop(first);
        assert_eq!(fs::read_dir(folder.path()).expect("a folder").count(), 0, "nothing is left");
        // A file that a killed process left has no holder.
        fs::write(folder.path().join(WORK.file), "process 1").expect("written");
        drop(FolderLock::take(folder.path(), &WORK).expect("free"));
        assert_eq!(fs::read_dir(folder.path()).expect("a folder").count(), 0);
    }

    /// The last holder goes between another's opening of the file and its locking it, and a third comes: that one has it.
    #[test]
    fn a_file_that_is_gone_locks_nothing() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let first = FolderLock::take(folder.path(), &WORK).expect("free");
        let open = || File::options().read(true).write(true).open(folder.path().join(WORK.file));
        let [early, late] = [open(), open()].map(|file| file.expect("it is there"));
        drop(first);
        assert!(FolderLock::take_open(folder.path(), early, &WORK).expect("no holder").is_none());
        let third = FolderLock::take(folder.path(), &WORK).expect("free");
        assert!(FolderLock::take_open(folder.path(), late, &WORK).expect("no holder").is_none());
        assert!(FolderLock::take(folder.path(), &WORK).is_err());
        drop(third);
    }
}
