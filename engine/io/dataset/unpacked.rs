//! A data set that may be one ZIP.

use std::fs::{self, File};
use std::io::{self, BufReader, Read};
use std::path::{Path, PathBuf};

use crate::{Error, Result};

/// No honest archive of photos unpacks to more than this many times its size.
const MAX_RATIO: u64 = 1032;

/// The folder of a data set: itself, or what its ZIP was unpacked to.
pub(crate) struct Unpacked {
    folder: PathBuf,
    archive: Option<(PathBuf, tempfile::TempDir)>,
}

impl Unpacked {
    /// Unpacks a ZIP to a temporary folder that goes with the value; a folder is taken as it is.
    pub(crate) fn open(path: &Path) -> Result<Self> {
        if !path.is_file() || !starts_like_zip(path) {
            return Ok(Self { folder: path.to_owned(), archive: None });
        }
        let target =
            tempfile::tempdir().map_err(|source| Error::io(std::env::temp_dir(), "create", source))?;
        extract(path, target.path())?;
        let folder = only_folder(target.path());
        Ok(Self { folder, archive: Some((path.to_owned(), target)) })
    }

    /// The folder.
    pub(crate) fn folder(&self) -> &Path {
        &self.folder
    }

    /// An error about a temporary file, as one about the archive.
    pub(crate) fn name(&self, error: Error) -> Error {
        let Some((archive, _)) = &self.archive else { return error };
        let inside = |path: PathBuf| match path.strip_prefix(&self.folder) {
            Ok(rest) => archive.join(rest),
            Err(_) => path,
        };
        match error {
            Error::Input { path, problem, remedy } => Error::Input { path: inside(path), problem, remedy },
            Error::Io { path, action, source } => Error::Io { path: inside(path), action, source },
            other => other,
        }
    }
}

fn starts_like_zip(path: &Path) -> bool {
    let mut start = [0; 4];
    File::open(path).and_then(|mut file| file.read_exact(&mut start)).is_ok() && start == *b"PK\x03\x04"
}

fn extract(path: &Path, target: &Path) -> Result<()> {
    let io = |source| Error::io(path, "read", source);
    let damaged =
        |problem: String| Error::input(path, problem, "the archive is damaged: pack or download it again");
    let file = File::open(path).map_err(io)?;
    let mut left = file.metadata().map_err(io)?.len().saturating_mul(MAX_RATIO);
    let mut archive =
        zip::ZipArchive::new(BufReader::new(file)).map_err(|e| damaged(format!("is no whole ZIP: {e}")))?;
    for index in 0..archive.len() {
        let mut entry = archive.by_index(index).map_err(|e| damaged(format!("entry {index}: {e}")))?;
        let name = entry.name().map_err(|e| damaged(format!("entry {index}: {e}")))?.into_owned();
        let Some(inside) = entry.enclosed_name() else {
            return Err(damaged(format!("{name:?} leads out of the archive")));
        };
        let place = target.join(inside);
        if entry.is_dir() {
            fs::create_dir_all(&place).map_err(|e| Error::io(&place, "create", e))?;
            continue;
        }
        if !entry.is_file() {
            return Err(damaged(format!("{name:?} is a link")));
        }
        if let Some(parent) = place.parent() {
            fs::create_dir_all(parent).map_err(|e| Error::io(parent, "create", e))?;
        }
        let mut output = File::create(&place).map_err(|e| Error::io(&place, "create", e))?;
        let copied = io::copy(&mut Read::take(&mut entry, left), &mut output);
        left -= copied.map_err(|e| damaged(format!("{name:?}: {e}")))?;
        if left == 0 {
            return Err(damaged("unpacks to far more than photos can".into()));
        }
    }
    Ok(())
}

/// Archives often hold one folder with everything in it.
fn only_folder(folder: &Path) -> PathBuf {
    let entries: Vec<PathBuf> =
        fs::read_dir(folder).into_iter().flatten().filter_map(|e| Some(e.ok()?.path())).collect();
    let is_data =
        |path: &Path| ["sparse", "images"].iter().any(|name| path.file_name().is_some_and(|n| n == *name));
    match entries.as_slice() {
        [only] if only.is_dir() && !is_data(only) => only.clone(),
        _ => folder.to_owned(),
    }
}
