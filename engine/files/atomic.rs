//! Writes files whole or not at all.
//!
//! Everything that this crate writes goes to a temporary name in the same folder, is flushed to the disk, and
//! is renamed when complete. If an error comes first, the old file stays and no partial one appears.

use std::fs::{self, File};
use std::io::{self, BufWriter, Seek, Write};
use std::path::{Path, PathBuf};

use ashsplat::{Error, Result};

const BUFFER_BYTES: usize = 1 << 20;

/// Writes a file through `fill`, whole or not at all.
///
/// A symbolic link is followed: its target is replaced. Devices and pipes (`/dev/stdout`) are written to
/// directly.
///
/// # Errors
/// [`Error::Io`] naming the file when `fill` or the file system fails (no such folder, no permission, disk
/// full). No temporary file remains then.
pub fn write(path: impl AsRef<Path>, fill: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> Result<()> {
    let path = path.as_ref();
    let io = |source| Error::io(path, "write", source);
    write_inner(path, |file| fill(file).map_err(io))
}

/// Output of [`write_seekable`]. A pipe cannot seek: the attempt is an error.
pub trait Output: Write + Seek {}

impl<T: Write + Seek> Output for T {}

/// Like [`write()`], for writers that seek back, or that have errors of their own.
///
/// # Errors
/// The error of `fill`, or [`Error::Io`] naming the file. No temporary file remains then.
pub fn write_seekable(
    path: impl AsRef<Path>,
    fill: impl FnOnce(&mut dyn Output) -> Result<()>,
) -> Result<()> {
    write_inner(path.as_ref(), fill)
}

/// Creates a folder and its parents; an existing one is fine.
///
/// # Errors
/// [`Error::Io`] naming the folder.
pub fn create_folder(path: impl AsRef<Path>) -> Result<()> {
    let path = path.as_ref();
    fs::create_dir_all(path).map_err(|source| Error::io(path, "create", source))
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
    ///
    /// # Errors
    /// [`Error::Io`] naming the file.
    pub fn persist(self) -> Result<()> {
        let Self { file, named, target } = self;
        let io = |source| Error::io(&named, "write", source);
        file.as_file().sync_all().map_err(io)?;
        file.persist(&target).map_err(|e| io(e.error))?;
        // The rename reaches the disk with the folder. If folders cannot be synchronised, it is only late.
        let _ = File::open(folder_of(&target)).and_then(|f| f.sync_all());
        Ok(())
    }
}

/// Creates an empty temporary file beside `path`. [`Unfinished::persist`] renames it; dropping it removes it. A
/// symbolic link is followed.
///
/// # Errors
/// [`Error::Io`] naming the file.
pub fn unfinished(path: impl AsRef<Path>) -> Result<Unfinished> {
    let named = path.as_ref();
    let io = |source| Error::io(named, "write", source);
    let target = destination(named).map_err(io)?;
    let folder = folder_of(&target);
    // An error here names the folder; the creation of the file below would name the temporary one.
    fs::metadata(folder).map_err(io)?;
    let file = temporary_file(&target, folder).map_err(io)?;
    Ok(Unfinished { file, named: named.to_owned(), target })
}

/// Folder of a file; `.` for a bare name.
fn folder_of(target: &Path) -> &Path {
    match target.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    }
}

fn write_inner(path: &Path, fill: impl FnOnce(&mut dyn Output) -> Result<()>) -> Result<()> {
    let io = |source| Error::io(path, "write", source);
    if fs::metadata(path).is_ok_and(|m| !m.is_file() && !m.is_dir()) {
        let file = File::options().write(true).open(path).map_err(io)?;
        let mut writer = BufWriter::with_capacity(BUFFER_BYTES, file);
        fill(&mut writer)?;
        return writer.flush().map_err(io);
    }
    let unfinished = unfinished(path)?;
    let mut writer = BufWriter::with_capacity(BUFFER_BYTES, unfinished.file.as_file());
    fill(&mut writer)?;
    writer.flush().map_err(io)?;
    drop(writer);
    unfinished.persist()
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
