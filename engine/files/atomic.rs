//! Writes files whole or not at all.
//!
//! Everything that this crate writes goes to a temporary name in the same folder, is flushed to the disk, and
//! is renamed when complete. If an error comes first, the old file stays and no partial one appears.

use std::fs::{self, File};
use std::io::{self, BufWriter, Seek, Write};
use std::path::{Path, PathBuf};

use crate::regular_file::OnFile;
use ashsplat::Result;

const BUFFER_BYTES: usize = 1 << 20;

/// Writes a file through `fill`, whole or not at all.
///
/// A symbolic link is followed: its target is replaced. Devices and pipes (`/dev/stdout`) are written directly.
///
/// # Errors
/// [`Error::Io`](ashsplat::Error::Io) naming the file when `fill` or the file system fails (no such folder, no permission, disk
/// full). No temporary file remains then.
pub fn write(path: impl AsRef<Path>, fill: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> Result<()> {
    let path = path.as_ref();
    write_seekable(path, |file| fill(file).writing(path))
}

/// Output of [`write_seekable`]. A pipe cannot seek: the attempt is an error.
pub trait Output: Write + Seek {}

impl<T: Write + Seek> Output for T {}

/// Like [`write()`], for writers that seek back, or that have errors of their own.
///
/// # Errors
/// The error of `fill`, or [`Error::Io`](ashsplat::Error::Io) naming the file. No temporary file remains then.
pub fn write_seekable(
    path: impl AsRef<Path>,
    fill: impl FnOnce(&mut dyn Output) -> Result<()>,
) -> Result<()> {
    let path = path.as_ref();
    if fs::metadata(path).is_ok_and(|m| !m.is_file() && !m.is_dir()) {
        let file = File::options().write(true).open(path).writing(path)?;
        let mut writer = BufWriter::with_capacity(BUFFER_BYTES, file);
        fill(&mut writer)?;
        return writer.flush().writing(path);
    }
    let unfinished = unfinished(path)?;
    let mut writer = BufWriter::with_capacity(BUFFER_BYTES, unfinished.file.as_file());
    fill(&mut writer)?;
    writer.flush().writing(path)?;
    drop(writer);
    unfinished.persist()
}

/// Creates a folder and its parents; an existing one is fine.
pub fn create_folder(path: impl AsRef<Path>) -> Result<()> {
    let path = path.as_ref();
    fs::create_dir_all(path).on(path, "create")
}

/// A temporary file that another program fills: see [`unfinished`].
#[derive(Debug)]
pub struct Unfinished {
    file: tempfile::NamedTempFile,
    /// Path as the caller gave it, for errors. `target` is that path after symbolic links.
    named: PathBuf,
    target: PathBuf,
}

impl Unfinished {
    /// Path of the temporary file.
    pub fn path(&self) -> &Path {
        self.file.path()
    }

    /// Flushes the temporary file and renames it to its final name.
    pub fn persist(self) -> Result<()> {
        let Self { file, named, target } = self;
        file.as_file().sync_all().writing(&named)?;
        file.persist(&target).map_err(|e| e.error).writing(&named)?;
        // The rename reaches the disk with the folder. Where folders cannot be synchronised, it reaches the disk later.
        #[allow(clippy::disallowed_methods)]
        let _ = File::open(folder_of(&target)).and_then(|f| f.sync_all());
        Ok(())
    }
}

/// Creates an empty temporary file beside `path`, or a link's target: [`Unfinished::persist`] renames it, dropping removes it.
pub fn unfinished(path: impl AsRef<Path>) -> Result<Unfinished> {
    let named = path.as_ref();
    let target = destination(named).writing(named)?;
    let folder = folder_of(&target);
    // An error here names the folder; the creation of the file below would name the temporary one.
    fs::metadata(folder).writing(named)?;
    let file = temporary_file(&target, folder).writing(named)?;
    Ok(Unfinished { file, named: named.to_owned(), target })
}

/// Folder of a file; `.` for a bare name.
fn folder_of(target: &Path) -> &Path {
    match target.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    }
}

/// The file that will be replaced: the target of a symbolic link.
fn destination(path: &Path) -> io::Result<PathBuf> {
    if fs::symlink_metadata(path).is_ok_and(|m| m.is_symlink()) && path.exists() {
        return fs::canonicalize(path);
    }
    Ok(path.to_owned())
}

/// An empty file in `folder` that removes itself unless it is renamed.
fn temporary_file(target: &Path, folder: &Path) -> io::Result<tempfile::NamedTempFile> {
    let name = target.file_name().ok_or_else(|| io::Error::other("the path names no file"))?;
    let mut prefix = std::ffi::OsString::from(".");
    prefix.push(name);
    prefix.push(".");
    let mut builder = tempfile::Builder::new();
    builder.prefix(&prefix).suffix(".tmp");
    // A new file's usual permissions (0666 less the umask), not the private ones of a temporary file.
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    builder.tempfile_in(folder)
}
